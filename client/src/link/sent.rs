//! Contacts on their way to the console, so that what it says of them can be understood.
//!
//! Entry point: [`SentContacts`]. The writer puts them in before their bytes go out, the reader takes them before it
//! tells of a state.

use std::collections::VecDeque;

/// Contacts that the reader may be behind by: with a thousand a second, half of what a silent console is given.
const MOST: usize = 256;

/// A contact that went out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SentContact {
    /// Number of its frame in the session: `State::contact_sequence` has it once it is in use,
    /// `State::heard_sequence` is no less from the tick on that was given it.
    pub sequence: u32,
    /// Console time of the state that it was solved for \[us\].
    pub console_time_us: u64,
    /// Its horizon \[us\], as the frame has it.
    pub horizon_us: u32,
}

/// A bounded queue of them; of too many the oldest is left out.
#[derive(Debug)]
pub(super) struct SentContacts(VecDeque<SentContact>);

impl Default for SentContacts {
    fn default() -> Self {
        SentContacts(VecDeque::with_capacity(MOST))
    }
}

impl SentContacts {
    /// Adds one that goes out now.
    pub fn put(&mut self, sent: SentContact) {
        if self.0.len() >= MOST {
            self.0.pop_front();
        }
        self.0.push_back(sent);
    }

    /// Takes the oldest.
    pub fn next(&mut self) -> Option<SentContact> {
        self.0.pop_front()
    }

    /// Their session is over.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(sequence: u32) -> SentContact {
        SentContact {
            sequence,
            console_time_us: 1000 * u64::from(sequence),
            horizon_us: 50_000,
        }
    }

    #[test]
    fn the_newest_stay_in_their_order_and_nothing_grows() {
        let mut contacts = SentContacts::default();
        let room = contacts.0.capacity();
        (0..3 * MOST as u32).for_each(|sequence| contacts.put(sent(sequence)));
        assert_eq!(contacts.0.capacity(), room);
        for sequence in 2 * MOST as u32..3 * MOST as u32 {
            assert_eq!(contacts.next(), Some(sent(sequence)));
        }
        assert_eq!(contacts.next(), None);
        contacts.put(sent(7));
        contacts.clear();
        assert_eq!(contacts.next(), None);
    }
}
