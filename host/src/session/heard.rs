//! What became of each contact that was sent, by what the console says in its states.
//!
//! Entry points: [`Underway::sent`], [`Underway::state`], [`Underway::lose`]; each contact ends in one [`Fate`]. The delay of
//! the loop is that of all contacts that came, and not only of those that came in time: a horizon that is made of the
//! latter never learns that it is too short.

use crate::link::SentContact;
use std::collections::VecDeque;
use sutura_shared::control::MAX_HORIZON_US;
use sutura_shared::wire::message::State;

/// Contacts that may be on their way: with a thousand a second, those of an eighth of one.
const MOST: usize = 128;

/// How a contact ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// The console renders it.
    Used {
        /// Age when it was first applied \[us\], as the console says.
        age_us: u32,
    },
    /// It came, and the console was not to use it any more.
    TooLate {
        /// Age when it came \[us\]: that of the first state from then on, exactly so where every tick's state comes.
        age_us: u32,
    },
    /// A newer one took its place before the console's tick, or the line lost it; or a fault ended all.
    Lost,
}

/// The contacts of which nothing has been heard yet, the oldest first.
#[derive(Debug)]
pub struct Underway(VecDeque<SentContact>);

impl Default for Underway {
    fn default() -> Self {
        Underway(VecDeque::with_capacity(MOST))
    }
}

impl Underway {
    /// Takes note of a contact that went out, in the order of their sequence, before the states that could know of it. Of
    /// too many the oldest is [`Fate::Lost`].
    pub fn sent(&mut self, contact: SentContact, mut each: impl FnMut(&SentContact, Fate)) {
        if self.0.len() >= MOST
            && let Some(oldest) = self.0.pop_front()
        {
            each(&oldest, Fate::Lost);
        }
        self.0.push_back(contact);
    }

    /// Takes note of a state of console time `console_time_us` \[us\]; tells the contacts whose fate is known by now.
    pub fn state(
        &mut self,
        console_time_us: u64,
        state: &State,
        mut each: impl FnMut(&SentContact, Fate),
    ) {
        let is_heard = |contact: &SentContact| {
            // As the link counts: half of the circle is newer.
            state.heard_sequence.wrapping_sub(contact.sequence) < 1 << 31
        };
        while let Some(contact) = self.0.pop_front_if(|contact| is_heard(contact)) {
            let age_us = console_time_us.saturating_sub(contact.console_time_us);
            let age_us = u32::try_from(age_us).unwrap_or(u32::MAX);
            let fate = if state.contact_sequence == contact.sequence {
                Fate::Used {
                    age_us: state.applied_age_us,
                }
            } else if self.0.front().is_some_and(is_heard) {
                Fate::Lost
            } else if age_us > contact.horizon_us.min(MAX_HORIZON_US) {
                Fate::TooLate { age_us }
            } else {
                Fate::Lost
            };
            each(&contact, fate);
        }
    }

    /// The link was lost, and all that was on its way.
    pub fn lose(&mut self, mut each: impl FnMut(&SentContact, Fate)) {
        self.0
            .drain(..)
            .for_each(|contact| each(&contact, Fate::Lost));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::control::{Control, TICK_US, TickInput};
    use sutura_shared::wire::message::{Command, Contact};
    use sutura_shared::wire::{Header, Kind, PROTOCOL_VERSION, ValidContact};
    use sutura_study::fidelity::plant::Mechanics;

    const HORIZON_US: u32 = 60_000;

    /// A console's control loop behind a line on which frames come when the test says.
    struct Bench {
        control: Control,
        now_us: u64,
        sequence: u32,
        underway: Underway,
        /// Sequence and fate.
        fates: Vec<(u32, Fate)>,
    }

    impl Bench {
        fn new() -> Self {
            let device = Mechanics::LIGHT.description();
            let mut control = Control::new(device).expect("a device of ours");
            control.command(Command::Arm);
            let mut bench = Bench {
                control,
                now_us: 1_000_000,
                sequence: 0,
                underway: Underway::default(),
                fates: Vec::new(),
            };
            bench.tick(None);
            bench
        }

        /// A contact solved for a state of `age_us` ago goes out.
        fn send(&mut self, age_us: u64) -> ValidContact {
            self.sequence = self.sequence.wrapping_add(1);
            let sent = SentContact {
                sequence: self.sequence,
                console_time_us: self.now_us - age_us,
                horizon_us: HORIZON_US,
            };
            let fates = &mut self.fates;
            self.underway
                .sent(sent, |contact, fate| fates.push((contact.sequence, fate)));
            frame(&sent)
        }

        /// A tick whose state comes.
        fn tick(&mut self, contact: Option<ValidContact>) {
            let state = self.silent_tick(contact);
            let fates = &mut self.fates;
            self.underway.state(self.now_us, &state, |contact, fate| {
                fates.push((contact.sequence, fate));
            });
        }

        /// A tick whose state the line loses.
        fn silent_tick(&mut self, contact: Option<ValidContact>) -> State {
            self.now_us += TICK_US;
            let input = TickInput {
                now_us: self.now_us,
                ..TickInput::default()
            };
            let fresh = contact.map(Into::into);
            self.control.tick(&input, fresh.as_ref()).state
        }

        fn order(&mut self) {
            self.sequence += 1;
            self.control.hear(self.sequence);
        }
    }

    fn frame(sent: &SentContact) -> ValidContact {
        let header = Header {
            version: PROTOCOL_VERSION,
            kind: Kind::Contact,
            session: 1,
            sequence: sent.sequence,
            console_time_us: sent.console_time_us,
        };
        let body = Contact {
            tool: 0,
            position_m: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [0.0; 6],
            tangent: [0.0; 21],
            gap_m: 0.0,
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: sent.horizon_us,
        };
        ValidContact::new(header, body).expect("a valid contact")
    }

    #[test]
    fn a_contact_in_time_is_used_at_the_age_that_the_console_measured() {
        let mut bench = Bench::new();
        let contact = bench.send(3_000);
        bench.tick(None);
        assert_eq!(bench.fates, []);
        bench.tick(Some(contact));
        bench.tick(None);
        assert_eq!(bench.fates, [(1, Fate::Used { age_us: 5_000 })]);
    }

    /// Used at its horizon to the microsecond, and not beyond; both are told, and so is one that the console caps.
    #[test]
    fn a_late_contact_is_told_with_its_age() {
        let mut bench = Bench::new();
        let contact = bench.send(u64::from(HORIZON_US) - TICK_US);
        bench.tick(Some(contact));
        let contact = bench.send(u64::from(HORIZON_US));
        bench.tick(Some(contact));
        bench.order();
        let contact = bench.send(360_000);
        // An order behind it, in the same tick.
        bench.order();
        bench.tick(Some(contact));
        let fates = [
            (1, Fate::Used { age_us: 60_000 }),
            (2, Fate::TooLate { age_us: 61_000 }),
            (4, Fate::TooLate { age_us: 361_000 }),
        ];
        assert_eq!(bench.fates, fates);
    }

    #[test]
    fn what_is_replaced_or_lost_is_neither_used_nor_late() {
        let mut bench = Bench::new();
        // Both came between two ticks: the newer one counts.
        bench.send(20_000);
        let newer = bench.send(10_000);
        bench.tick(Some(newer));
        // The line lost this one.
        bench.send(1_000);
        for _ in 0..30 {
            bench.tick(None);
        }
        let next = bench.send(1_000);
        bench.tick(Some(next));
        let fates = [
            (1, Fate::Lost),
            (2, Fate::Used { age_us: 11_000 }),
            (3, Fate::Lost),
            (4, Fate::Used { age_us: 2_000 }),
        ];
        assert_eq!(bench.fates, fates);
    }

    /// Where states are lost the age of a late one may be a little too large, and one that was used and replaced meanwhile
    /// is not known to have been.
    #[test]
    fn a_lost_state_costs_no_fate() {
        let mut bench = Bench::new();
        let late = bench.send(100_000);
        bench.silent_tick(Some(late));
        bench.tick(None);
        let first = bench.send(0);
        bench.silent_tick(Some(first));
        let second = bench.send(0);
        bench.silent_tick(Some(second));
        bench.tick(None);
        let fates = [
            (1, Fate::TooLate { age_us: 102_000 }),
            (2, Fate::Lost),
            (3, Fate::Used { age_us: 1_000 }),
        ];
        assert_eq!(bench.fates, fates);
    }

    /// Each contact has one fate, however many there are, and nothing grows.
    #[test]
    fn a_silent_console_or_a_lost_link_leaves_nothing_behind() {
        let mut bench = Bench::new();
        let room = bench.underway.0.capacity();
        for _ in 0..3 * MOST {
            bench.send(0);
        }
        assert_eq!(bench.underway.0.capacity(), room);
        assert_eq!(bench.fates.len(), 2 * MOST);
        let fates = &mut bench.fates;
        bench
            .underway
            .lose(|contact, fate| fates.push((contact.sequence, fate)));
        let expected: Vec<_> = (1..=3 * MOST as u32).map(|n| (n, Fate::Lost)).collect();
        assert_eq!(bench.fates, expected);
    }

    /// The sequence wraps around.
    #[test]
    fn the_circle_goes_on() {
        let mut bench = Bench::new();
        bench.sequence = u32::MAX - 2;
        bench.control.hear(u32::MAX - 2);
        for _ in 0..4 {
            let contact = bench.send(0);
            bench.tick(Some(contact));
        }
        let sequences: Vec<_> = bench.fates.iter().map(|(sequence, _)| *sequence).collect();
        assert_eq!(sequences, [u32::MAX - 1, u32::MAX, 0, 1]);
        let used = |(_, fate): &(u32, Fate)| *fate == Fate::Used { age_us: 1_000 };
        assert!(bench.fates.iter().all(used));
    }
}
