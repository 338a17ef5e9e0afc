//! What a console is told, and how it becomes frames.
//!
//! Entry points: [`Order::append`], [`Felt::append`], [`append`].

use super::sent::SentContact;
use sutura_shared::link::{HostLink, SendError};
use sutura_shared::wire::message::{Command, Contact, Fixture, Needle, Rows, Simulate, Thread};
use sutura_shared::wire::{MAX_FRAME, Message, Reject};

/// What a console can be told, apart from contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "a handful per session")]
pub enum Order {
    /// To any console.
    Command(Command),
    /// To any console.
    Fixture(Fixture),
    /// To a simulated one.
    Simulate(Simulate),
}

/// What the console is told of one solve: sent together, the contact last, or not at all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Felt {
    /// The contact of the console's tool.
    pub contact: Contact,
    /// Its rows.
    pub rows: Option<Rows>,
    /// The needle in its grip.
    pub needle: Option<Needle>,
    /// The thread that pulls at it.
    pub thread: Option<Thread>,
}

/// Writes one frame of whatever kind behind what is there.
///
/// # Errors
/// Numbers that are not finite or out of range; nothing was written then.
pub fn append<M: Message>(
    end: &mut HostLink,
    console_time_us: u64,
    body: &M,
    frames: &mut Vec<u8>,
) -> Result<(), SendError> {
    let mut frame = [0; MAX_FRAME];
    let length = end.send(console_time_us, body, &mut frame)?;
    frames.extend_from_slice(&frame[..length]);
    Ok(())
}

impl Felt {
    /// Checks contact, needle and thread as the console will; rows are checked as they are written.
    ///
    /// # Errors
    /// Numbers that are not finite or out of range.
    pub fn check(&self) -> Result<(), Reject> {
        self.contact.check()?;
        if let Some(thread) = &self.thread {
            thread.check()?;
        }
        self.needle.as_ref().map_or(Ok(()), Needle::check)
    }

    /// Writes rows, needle, thread and contact behind what is there, or none of them: what the console would refuse takes no
    /// number in the sequence, so that it does not miss it.
    ///
    /// # Errors
    /// Numbers that are not finite or out of range; nothing was written then, and the console ages out what it has.
    pub fn append(
        &self,
        end: &mut HostLink,
        console_time_us: u64,
        frames: &mut Vec<u8>,
    ) -> Result<SentContact, SendError> {
        let Felt {
            contact,
            rows,
            needle,
            thread,
        } = self;
        // Before another frame takes its number in the sequence; rows are the first.
        self.check().map_err(SendError::Invalid)?;
        if let Some(rows) = rows {
            append(end, console_time_us, rows, frames)?;
        }
        if let Some(needle) = needle {
            append(end, console_time_us, needle, frames)?;
        }
        if let Some(thread) = thread {
            append(end, console_time_us, thread, frames)?;
        }
        append(end, console_time_us, contact, frames)?;
        Ok(SentContact {
            sequence: end.sent_sequence(),
            console_time_us,
            horizon_us: contact.horizon_us,
        })
    }
}

impl Order {
    /// Writes its frame behind what is there.
    ///
    /// # Errors
    /// Numbers that are not finite or out of range; nothing was written then.
    pub fn append(
        &self,
        end: &mut HostLink,
        console_time_us: u64,
        frames: &mut Vec<u8>,
    ) -> Result<(), SendError> {
        match self {
            Order::Command(command) => append(end, console_time_us, command, frames),
            Order::Fixture(fixture) => append(end, console_time_us, fixture, frames),
            Order::Simulate(simulate) => append(end, console_time_us, simulate, frames),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::link::{ConsoleLink, Identity};
    use sutura_shared::wire::Reject;
    use sutura_shared::wire::message::{Course, End, Friction, Tension, Tip};

    const CONTACT: Contact = Contact {
        tool: 0,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        wrench: [0.0; 6],
        tangent: [0.0; 21],
        gap_m: 0.0,
        normal: [0.0, 0.0, 1.0],
        relaxation_per_s: 0.0,
        horizon_us: 50_000,
    };
    const NEEDLE: Needle = Needle {
        tool: 0,
        needle: 0,
        slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        tip: Tip::Outside,
        friction: Friction::Sticks,
        axial_n: 0.0,
        friction_n: [0.0; 2],
        stiffness_n_per_m: [0.0; 2],
        hold_n: 0.0,
        puncture_n: 1.0,
        punctured_n: 0.0,
        course: Course {
            forward: 0,
            backward: 0,
            points: [[0.0; 2]; 12],
        },
    };

    const THREAD: Thread = Thread {
        tool: 0,
        thread: 0,
        end: End::Head,
        state: Tension::Taut,
        direction: [0.0, 0.0, 1.0],
        tension_n: 1.0,
        stiffness_n_per_m: 100.0,
        slack_m: 0.0,
    };

    /// What would be refused of the three holds all of them back and takes no number in the sequence, so that the
    /// console does not count it as lost.
    #[test]
    fn needle_thread_and_contact_go_together_or_not_at_all() {
        let identity = Identity {
            tick_hz: 1000,
            simulated: false,
            device_name: *b"bench\0\0\0\0\0\0\0\0\0\0\0",
        };
        let (mut host, mut console) = (HostLink::new(1000), ConsoleLink::new(identity, 7));
        let mut frame = [0; MAX_FRAME];
        let length = host.hello(3, &mut frame).expect("fits");
        console.receive(&mut &frame[..length], 0);
        let length = console.take_reply(0, &mut frame).expect("an answer");
        frame[..length].iter().for_each(|byte| {
            host.receive(*byte);
        });

        let bad_contact = Contact {
            gap_m: f32::NAN,
            ..CONTACT
        };
        let bad_needle = Needle {
            hold_n: -1.0,
            ..NEEDLE
        };
        let bad_thread = Thread {
            slack_m: 0.1,
            ..THREAD
        };
        let mut frames = Vec::new();
        let mut append = |contact, needle, thread| {
            let felt = Felt {
                contact,
                rows: None,
                needle: Some(needle),
                thread: Some(thread),
            };
            felt.append(&mut host, 0, &mut frames)
                .map(|sent| sent.sequence)
        };
        let not_finite = Err(SendError::Invalid(Reject::NotFinite));
        assert_eq!(append(bad_contact, NEEDLE, THREAD), not_finite);
        let range = Err(SendError::Invalid(Reject::Range));
        assert_eq!(append(CONTACT, bad_needle, THREAD), range);
        assert_eq!(append(CONTACT, NEEDLE, bad_thread), range);
        let sequence = append(CONTACT, NEEDLE, THREAD);
        assert_eq!(sequence, Ok(host.sent_sequence()));
        let mut rest = &frames[..];
        let heard: Vec<_> = std::iter::from_fn(|| console.receive(&mut rest, 0)).collect();
        assert_eq!(heard.len(), 3, "{heard:?}");
        assert_eq!(console.counters().frames_lost, 0);
    }
}
