//! Whether a contact has come with all that belongs to it: rows, needle and thread of the same console time.
//!
//! Entry point: [`Companions::note`] for every frame of a session. A host sends them directly before their contact, always in the
//! order rows, needle, thread, contact. A gap in the sequence between two of them says which ones the line may have lost. A contact
//! without them would be a bare tangent: tissue that does not slip, and a needle that nothing bounds.

use crate::wire::Kind;

/// The companions of one contact, as they come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Companions {
    /// Sequence of the newest frame.
    sequence: u32,
    /// Console time of the companions that came last \[us\].
    time_us: u64,
    /// Place of the newest of them in their order; 0 if the newest frame belongs to no contact.
    place: u8,
    /// Kinds that have come, and kinds that the line may have lost: bits by place.
    came: u8,
    lost: u8,
    /// Kinds that came with the last contact that was used.
    usual: u8,
}

/// Place of a contact in the order of its companions.
const CONTACT: u8 = 4;

/// Place of a kind in the order in which a host sends a contact and its companions.
fn place_of(kind: Kind) -> Option<u8> {
    match kind {
        Kind::Rows => Some(1),
        Kind::Needle => Some(2),
        Kind::Thread => Some(3),
        Kind::Contact => Some(CONTACT),
        _ => None,
    }
}

impl Companions {
    /// At the start of a session.
    pub const NONE: Companions = Companions {
        sequence: 0,
        time_us: 0,
        place: 0,
        came: 0,
        lost: 0,
        usual: 0,
    };

    /// Takes note of a frame of the session that has been accepted. `tool`: of a contact or a companion; frames of other tools than
    /// the console's grip, which is tool 0, belong to no contact here.
    ///
    /// Returns whether it can be used: a contact cannot if the line may have lost a companion of a kind that came with
    /// the last one that was used.
    pub fn note(&mut self, kind: Kind, sequence: u32, tool: u8, time_us: u64) -> bool {
        let is_next = sequence == self.sequence.wrapping_add(1);
        self.sequence = sequence;
        let Some(place) = place_of(kind).filter(|_| tool == 0) else {
            self.place = 0;
            return true;
        };
        if self.place == 0 || self.place >= place || self.time_us != time_us {
            (self.place, self.came, self.lost) = (0, 0, 0);
            self.time_us = time_us;
        }
        if !is_next {
            self.lost |= (1_u8 << place) - (2_u8 << self.place);
        }
        self.place = place;
        if place < CONTACT {
            self.came |= 1 << place;
            return true;
        }
        self.place = 0;
        if self.lost & self.usual != 0 {
            return false;
        }
        self.usual = self.came;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Contacts that can be used of a line that carries frames (kind, sequence, console time).
    fn used(frames: &[(Kind, u32, u64)]) -> [u32; 8] {
        let mut companions = Companions::NONE;
        let mut used = [0; 8];
        let mut places = used.iter_mut();
        for (kind, sequence, time_us) in frames {
            let can_be_used = companions.note(*kind, *sequence, 0, *time_us);
            assert!(can_be_used || *kind == Kind::Contact);
            if can_be_used && *kind == Kind::Contact {
                *places.next().expect("few contacts") = *sequence;
            }
        }
        used
    }

    #[test]
    fn a_contact_that_lacks_a_companion_by_the_sequence_is_not_used() {
        use Kind::{Contact, Needle, Rows, Thread};
        let whole = |first: u32, time_us: u64| {
            let kinds = [Rows, Needle, Thread, Contact].into_iter().zip(first..);
            kinds.map(move |(kind, sequence)| (kind, sequence, time_us))
        };
        for lost in 5..=8 {
            let frames = whole(1, 10).chain(whole(5, 20)).chain(whole(9, 30));
            let mut came = [(Rows, 0, 0); 11];
            let kept = frames.filter(|(_, sequence, _)| *sequence != lost);
            came.iter_mut().zip(kept).for_each(|(to, from)| *to = from);
            // The lost contact is not there, and the one after it is whole.
            let expected = [4, 12, 0, 0, 0, 0, 0, 0];
            assert_eq!(used(&came), expected, "{lost}");
        }
    }

    #[test]
    fn what_a_host_does_not_send_is_not_missed() {
        use Kind::{Contact, Needle, Ping, Rows, Thread};
        // Bare ones over a line that loses every second frame; a needle before which another frame is lost.
        assert_eq!(
            used(&[(Contact, 1, 1), (Contact, 3, 3), (Contact, 5, 5)])[..3],
            [1, 3, 5]
        );
        assert_eq!(
            used(&[
                (Needle, 1, 1),
                (Contact, 2, 1),
                (Needle, 4, 3),
                (Contact, 5, 3)
            ])[..2],
            [2, 5]
        );
        // Without a gap nothing is lost: the host has no rows any more, or says something in between.
        assert_eq!(
            used(&[(Rows, 1, 1), (Contact, 2, 1), (Ping, 3, 2), (Contact, 4, 3)])[..2],
            [2, 4]
        );
        // What is lost before a frame that belongs to no contact is none of the next contact's companions.
        assert_eq!(
            used(&[
                (Thread, 1, 1),
                (Contact, 2, 1),
                (Ping, 4, 2),
                (Contact, 5, 3)
            ])[..2],
            [2, 5]
        );
        // Lost for once: the next one counts again.
        assert_eq!(
            used(&[
                (Rows, 1, 1),
                (Contact, 2, 1),
                (Contact, 4, 2),
                (Contact, 5, 3)
            ])[..2],
            [2, 5]
        );
    }
}
