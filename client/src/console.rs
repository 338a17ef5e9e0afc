//! A session with a console. Entry point: [`Console::open`].

use crate::link::{Felt, Link, LinkCounters, LinkOptions, Order, Port, Standing, open_serial};
use crate::{Contact, Error, Lead, Pose};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use sutura_shared::link::SendError;
use sutura_shared::wire::Message;
use sutura_shared::wire::message::{Command, Fixture, Hello, Rows, Simulate};

/// What a simulator decides about its session.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// How long the console may go on with a contact before its force fades, from the pose that it was computed for; the
    /// console caps it at 150 ms. Three periods of the simulator and the line's delay: 60 ms suits one that runs at 60 Hz.
    pub horizon: Duration,
    /// Shortest time between two contacts on the line; a newer one replaces the one that waits. 0 on USB, 10 ms on a
    /// UART of 115200 baud.
    pub contact_spacing: Duration,
    /// How long the console may take to answer.
    pub answer_within: Duration,
    /// Whether to give up, asked while a session is opened.
    pub give_up: fn() -> bool,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            horizon: Duration::from_millis(60),
            contact_spacing: Duration::ZERO,
            answer_within: Duration::from_secs(3),
            give_up: || false,
        }
    }
}

impl Options {
    fn of_link(&self) -> LinkOptions {
        LinkOptions {
            contact_spacing: self.contact_spacing,
            answer_within: self.answer_within,
            give_up: self.give_up,
            ..LinkOptions::default()
        }
    }

    fn horizon_us(&self) -> u32 {
        u32::try_from(self.horizon.as_micros()).unwrap_or(u32::MAX)
    }
}

/// An open session with a console. Dropping it disarms the console.
#[derive(Debug)]
pub struct Console {
    link: Link,
    horizon_us: u32,
    lead: Mutex<Lead>,
}

impl Console {
    /// Opens a session with the console on a serial port or pseudo-terminal. A console that goes away and comes back (a
    /// cable, a reset) gets a new session by itself; it is disarmed then, and stays so until [`arm`](Self::arm).
    ///
    /// # Errors
    /// No such port, no permission, in use; no answer; a console of another release. [`Error::help`] has the next step.
    pub fn open(port: &str, options: Options) -> Result<Console, Error> {
        let name = port.to_owned();
        let connect = move || open_serial(&name);
        Ok(Console {
            link: Link::open_with(connect, options.of_link(), |_| {})?,
            horizon_us: options.horizon_us(),
            lead: Mutex::default(),
        })
    }

    /// Opens a session over any pipe of bytes, until that breaks.
    ///
    /// # Errors
    /// As of [`open`](Self::open).
    pub fn over(port: Box<dyn Port>, options: Options) -> Result<Console, Error> {
        Ok(Console {
            link: Link::open(port, options.of_link(), |_| {})?,
            horizon_us: options.horizon_us(),
            lead: Mutex::default(),
        })
    }

    /// What the console said of itself: name, control rate, whether it is simulated.
    pub fn info(&self) -> Hello {
        self.link.console()
    }

    /// Whether a session is open now; else the console is away and looked for, or the link is over.
    pub fn is_connected(&self) -> bool {
        matches!(self.link.standing(), Standing::Open(_))
    }

    /// Turns the motors on. The first force after it is 0 and grows from there.
    ///
    /// # Errors
    /// [`Error::Gone`], [`Error::Stuck`]: as of every order.
    pub fn arm(&self) -> Result<(), Error> {
        self.order(Order::Command(Command::Arm))
    }

    /// Turns the motors off.
    ///
    /// # Errors
    /// As of [`arm`](Self::arm).
    pub fn disarm(&self) -> Result<(), Error> {
        self.order(Order::Command(Command::Disarm))
    }

    /// Leaves a latched fault whose cause is gone; the console stays disarmed.
    ///
    /// # Errors
    /// As of [`arm`](Self::arm).
    pub fn clear_fault(&self) -> Result<(), Error> {
        self.order(Order::Command(Command::ClearFault))
    }

    /// The newest pose that was not read yet; waits for one up to `timeout`, `None` if none came.
    ///
    /// # Errors
    /// [`Error::Gone`] once the link is broken.
    pub fn pose(&self, timeout: Duration) -> Result<Option<Pose>, Error> {
        let state = self.link.state(Instant::now() + timeout)?;
        Ok(state.as_ref().map(Pose::from))
    }

    /// Where the grip will be, across the contact's `normal`, while what is solved for `pose` is in use, with a contact every
    /// `period`: solve for this pose and send it with the contact, and strokes over round bodies are rendered from both sides. Without a
    /// contact, (0, 0, 0), it is `pose`. See [`Lead`].
    pub fn ahead(&self, pose: &Pose, normal: [f32; 3], period: Duration) -> Pose {
        let mut lead = self.lead.lock().unwrap_or_else(PoisonError::into_inner);
        lead.pose(pose, normal, period)
    }

    /// Sends the contact that was computed for `pose`, in the place of one that still waits to be sent.
    ///
    /// # Errors
    /// [`Error::Unsendable`] if a number is not finite or out of range, or the normal is no unit vector;
    /// [`Error::Gone`].
    pub fn send_contact(&self, pose: &Pose, contact: &Contact) -> Result<(), Error> {
        self.send(pose, contact, None)
    }

    /// Sends a plain force \[N\], (3): see [`Contact::force`].
    ///
    /// # Errors
    /// As of [`send_contact`](Self::send_contact).
    pub fn send_force(&self, pose: &Pose, force_n: [f32; 3]) -> Result<(), Error> {
        self.send_contact(pose, &Contact::force(force_n))
    }

    /// Sends a contact with its rows, a small problem that the console solves anew at every tick: see [`Rows`].
    ///
    /// # Errors
    /// As of [`send_contact`](Self::send_contact).
    pub fn send_rows(&self, pose: &Pose, contact: &Contact, rows: &Rows) -> Result<(), Error> {
        self.sendable(rows)?;
        self.send(pose, contact, Some(*rows))
    }

    /// Puts up a wall or a coupling that the console renders by itself, with or without contacts.
    ///
    /// # Errors
    /// [`Error::Unsendable`], and as of [`arm`](Self::arm).
    pub fn fixture(&self, fixture: &Fixture) -> Result<(), Error> {
        self.sendable(fixture)?;
        self.order(Order::Fixture(*fixture))
    }

    /// Tells a simulated console what hand holds it, or what device it is. A console with motors refuses this.
    ///
    /// # Errors
    /// [`Error::Unsendable`], and as of [`arm`](Self::arm).
    pub fn simulate(&self, order: &Simulate) -> Result<(), Error> {
        self.sendable(order)?;
        self.order(Order::Simulate(*order))
    }

    /// What went over the link so far.
    pub fn counters(&self) -> LinkCounters {
        self.link.counters()
    }

    /// Disarms the console and ends the session.
    pub fn close(self) -> LinkCounters {
        self.link.close()
    }

    fn order(&self, order: Order) -> Result<(), Error> {
        self.link.order(order)
    }

    fn send(&self, pose: &Pose, contact: &Contact, rows: Option<Rows>) -> Result<(), Error> {
        let contact = contact.frame(pose, self.horizon_us);
        self.sendable(&contact)?;
        self.link.check()?;
        let felt = Felt {
            contact,
            rows,
            needle: None,
            thread: None,
        };
        self.link.felt(pose.time_us, felt);
        Ok(())
    }

    fn sendable<M: Message>(&self, message: &M) -> Result<(), Error> {
        message.check().map_err(|reject| Error::Unsendable {
            name: self.link.name().to_owned(),
            source: SendError::Invalid(reject),
        })
    }
}
