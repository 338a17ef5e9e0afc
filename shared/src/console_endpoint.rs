//! A console beside its control loop: what comes down becomes contacts and orders to it, and what a tick gives goes up.
//!
//! Entry points: [`ConsoleEndpoint::receive`], [`Order::obey`], [`ConsoleEndpoint::send`]. Boards, which do both in tasks of their own,
//! simulations and replays have the same one.

use crate::control::{Control, Fresh};
use crate::link::{ConsoleLink, LinkEvent};
use crate::wire::message::{Mode, Report, Simulate, State};
use crate::wire::{
    MAX_FRAME, ValidCommand, ValidContact, ValidFixture, ValidNeedle, ValidSimulate, ValidThread,
};

/// Ticks between two reports. One more comes with the answer to a `Hello`, so that a session knows what
/// had been counted before it.
pub const REPORT_EVERY: u32 = 1000;

/// What the host wants of the control loop, apart from contacts; to be obeyed in the order in which it came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// A new session.
    OpenSession,
    /// The session is over.
    CloseSession,
    /// From the host.
    Command(ValidCommand),
    /// From the host. The newest counts: the control loop finds out which that is.
    Needle(ValidNeedle),
    /// From the host. The newest counts, as of needles.
    Thread(ValidThread),
    /// From the host.
    Fixture(ValidFixture),
    /// From the host, to a simulated console.
    Simulate(ValidSimulate),
}

impl Order {
    /// Whether a contact that no tick has taken is void: another session's.
    pub fn voids_contacts(&self) -> bool {
        matches!(self, Order::OpenSession | Order::CloseSession)
    }

    /// Has the control loop do so. `simulate` is what a simulation does with an order to it; a console with motors gets none.
    pub fn obey(&self, control: &mut Control, simulate: impl FnOnce(&Simulate, &mut Control)) {
        let sequence = match self {
            Order::OpenSession => return control.open_session(),
            Order::CloseSession => return control.close_session(),
            Order::Command(command) => {
                control.command(*command.body());
                command.sequence()
            }
            Order::Needle(needle) => {
                control.needle(needle);
                needle.sequence()
            }
            Order::Thread(thread) => {
                control.thread(thread);
                thread.sequence()
            }
            Order::Fixture(fixture) => {
                control.fix(fixture);
                fixture.sequence()
            }
            Order::Simulate(order) => {
                simulate(order.body(), control);
                order.sequence()
            }
        };
        control.hear(sequence);
    }
}

/// What has come down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Delivery {
    /// Takes the place of one that no tick has taken; see [`ConsoleEndpoint::fresh`].
    Contact(ValidContact),
    /// For the control loop, after those that came before.
    Order(Order),
}

/// What the ticks have cost so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Costs {
    /// Ticks that took longer than their period.
    pub overruns: u32,
    /// Ticks that began more than a period late.
    pub late: u32,
    /// Most that one took, in the board's unit.
    pub cost_max: u32,
}

/// What a tick leaves to be sent.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Console time of the tick \[us\].
    pub now_us: u64,
    /// Its outcome.
    pub state: State,
    /// Of the ticks before it.
    pub costs: Costs,
}

impl Sample {
    /// What buffers hold before the first tick; never sent.
    pub const BEFORE_THE_FIRST: Sample = Sample {
        now_us: 0,
        state: State {
            tick: 0,
            position_m: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            force_n: [0.0; 3],
            current_a: [0.0; 3],
            mode: Mode::Boot,
            faults: 0,
            contact_sequence: 0,
            contact_age_us: u32::MAX,
            applied_age_us: u32::MAX,
            trace_hash: 0,
            encoder_counts: [0; 3],
            inputs: 0,
            heard_sequence: 0,
        },
        costs: Costs {
            overruns: 0,
            late: 0,
            cost_max: 0,
        },
    };
}

/// The console's end of the link, with what its reports say.
#[derive(Clone, Debug)]
pub struct ConsoleEndpoint {
    link: ConsoleLink,
    report: Report,
}

impl ConsoleEndpoint {
    /// `boot`: what every report says about the last boot.
    pub fn new(link: ConsoleLink, boot: Report) -> Self {
        ConsoleEndpoint { link, report: boot }
    }

    /// Takes bytes that came on the console's clock, up to the frame that brings something: `bytes` is what is left of them then, and
    /// empty if none does.
    pub fn receive(&mut self, bytes: &mut &[u8], now_us: u64) -> Option<Delivery> {
        loop {
            let event = self.link.receive(bytes, now_us)?;
            let delivery = delivery(event);
            if delivery.is_some() {
                return delivery;
            }
        }
    }

    /// Closes a session in which nothing has come for too long.
    pub fn expire(&mut self, now_us: u64) -> Option<Delivery> {
        let event = self.link.expire(now_us)?;
        delivery(event)
    }

    /// Closes the session whose line has ended, as by a reset of the bus.
    pub fn close(&mut self, now_us: u64) -> Option<Delivery> {
        let event = self.link.close(now_us)?;
        delivery(event)
    }

    /// A contact that has just come, with its rows.
    pub fn fresh(&self, contact: ValidContact) -> Fresh {
        Fresh::of(contact, self.link.rows())
    }

    /// Counts a contact that a newer one took the place of before a tick took it.
    pub fn count_superseded(&mut self) {
        self.report.frames_superseded = self.report.frames_superseded.wrapping_add(1);
    }

    /// Whether a report follows this tick: every [`REPORT_EVERY`] ticks, and with the answer to a `Hello`.
    pub fn report_is_due(&self, sample: &Sample) -> bool {
        self.link.reply_waits() || sample.state.tick.is_multiple_of(REPORT_EVERY)
    }

    /// Gives the answer to a `Hello`, if there is one to give, at a console time.
    pub fn reply(&mut self, now_us: u64, mut push: impl FnMut(&[u8])) {
        let mut frame = [0; MAX_FRAME];
        if let Some(length) = self.link.take_reply(now_us, &mut frame) {
            push(frame.get(..length).unwrap_or_default());
        }
    }

    /// Gives what is due after a tick, in order: the answer to a `Hello`, `State`, `Pong`, `Report`. `clock_us` is the
    /// console's clock now. Returns whether a host was given a `Report`.
    pub fn send(&mut self, sample: &Sample, clock_us: u64, mut push: impl FnMut(&[u8])) -> bool {
        let report_is_due = self.report_is_due(sample);
        self.reply(sample.now_us, &mut push);
        let mut frame = [0; MAX_FRAME];
        let mut give = |frame: &[u8; MAX_FRAME], length: usize| {
            push(frame.get(..length).unwrap_or_default());
        };
        let tick = sample.state.tick;
        if tick.is_multiple_of(u32::from(self.link.state_every())) {
            let length = self
                .link
                .encode_state(sample.now_us, &sample.state, &mut frame);
            give(&frame, length);
        }
        let length = self.link.encode_pong(clock_us, &mut frame);
        give(&frame, length);
        if report_is_due {
            let report = Report {
                ticks: tick,
                tick_overruns: sample.costs.overruns,
                ticks_late: sample.costs.late,
                tick_cost_max: sample.costs.cost_max,
                ..self.report
            };
            let length = self.link.encode_report(sample.now_us, &report, &mut frame);
            give(&frame, length);
            return length > 0;
        }
        false
    }

    /// Changes what every report says about this console.
    pub fn report(&mut self) -> &mut Report {
        &mut self.report
    }

    /// The link, to look at.
    pub fn link(&self) -> &ConsoleLink {
        &self.link
    }
}

fn delivery(event: LinkEvent) -> Option<Delivery> {
    Some(match event {
        // They wait in the link for their contact.
        LinkEvent::Rows => return None,
        LinkEvent::Contact(contact) => Delivery::Contact(contact),
        LinkEvent::SessionOpened => Delivery::Order(Order::OpenSession),
        LinkEvent::SessionClosed => Delivery::Order(Order::CloseSession),
        LinkEvent::Command(command) => Delivery::Order(Order::Command(command)),
        LinkEvent::Needle(needle) => Delivery::Order(Order::Needle(needle)),
        LinkEvent::Thread(thread) => Delivery::Order(Order::Thread(thread)),
        LinkEvent::Fixture(fixture) => Delivery::Order(Order::Fixture(fixture)),
        LinkEvent::Simulate(order) => Delivery::Order(Order::Simulate(order)),
    })
}
