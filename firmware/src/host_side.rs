//! Everything between the bytes of the host and the control task: what the link and telemetry tasks run.
//!
//! Entry points: [`HostSide::receive`] for the link task, [`HostSide::send`] for the telemetry task.

use crate::outbox::Outbox;
use heapless::spsc::{Consumer, Producer, Queue};
use sutura_shared::console_endpoint::{ConsoleEndpoint, Delivery, Order, Sample};
use sutura_shared::control::Fresh;
use sutura_shared::link::ConsoleLink;
use sutura_shared::mutant::stands;
use sutura_shared::wire::MAX_REAL_TIME_FRAME;
use sutura_shared::wire::message::Report;

/// A byte stream that never waits.
pub trait Bytes {
    /// Most bytes that are taken in one tick; the rest waits in the port. What comes faster than the board can chew must not
    /// starve telemetry and the watchdogs.
    const PER_TICK: usize = usize::MAX;
    /// Whether the host has begun the line anew since this was last asked: its session is over.
    fn has_begun_anew(&mut self) -> bool {
        false
    }
    /// Takes what has arrived, up to the length of `bytes`; 0 = nothing more now.
    fn read(&mut self, bytes: &mut [u8]) -> usize;
    /// Sends what fits; 0 = nothing more fits now.
    fn write(&mut self, bytes: &[u8]) -> usize;
}

/// A buffer for the newest contact; `None` forgets an older one.
pub type Slot = Option<Fresh>;

/// Room for orders of one tick.
const ORDERS: usize = 16;
/// Smallest frame that is an order \[bytes\]: header, one byte, CRC, delimiter and COBS code.
const SMALLEST_FRAME: usize = 18 + 1 + 4 + 2;
/// Bytes taken from the port at a time.
const CHUNK: usize = 64;

/// Orders on their way to the control task.
pub type Orders = Queue<Order, ORDERS>;
/// The control task's end of [`Orders`].
pub type OrdersOut<'a> = Consumer<'a, Order>;

/// The link, its port, and the ends of what leads to the control task.
pub struct HostSide<'a, P> {
    endpoint: ConsoleEndpoint,
    port: P,
    orders: Producer<'a, Order>,
    back: &'a mut Slot,
    outbox: Outbox<{ 8 * MAX_REAL_TIME_FRAME }>,
    /// Bytes that may still be taken in this tick.
    budget: usize,
}

impl<'a, P: Bytes> HostSide<'a, P> {
    /// `boot`: what every report says about the last boot.
    pub fn new(
        link: ConsoleLink,
        port: P,
        orders: Producer<'a, Order>,
        back: &'a mut Slot,
        boot: Report,
    ) -> Self {
        Self {
            endpoint: ConsoleEndpoint::new(link, boot),
            port,
            orders,
            back,
            outbox: Outbox::new(),
            budget: P::PER_TICK,
        }
    }

    /// Takes all bytes that have arrived by now on the console's clock. `publish` swaps a buffer into the exchange of contacts, under its
    /// lock, and says whether an unread one came back.
    ///
    /// False if bytes may have been left in the port, because orders wait for the control task or the tick's bytes have been
    /// taken: until the next tick has been sent there is no use in calling again.
    pub fn receive(
        &mut self,
        now_us: u64,
        mut publish: impl FnMut(&mut &'a mut Slot) -> bool,
    ) -> bool {
        let mut bytes = [0; CHUNK];
        if self.has_room() {
            let over = if self.port.has_begun_anew() {
                self.endpoint.close(now_us)
            } else {
                self.endpoint.expire(now_us)
            };
            if let Some(delivery) = over {
                self.apply(delivery, &mut publish);
            }
        }
        // While the control task has not taken its orders, the port keeps the rest.
        let mut has_all = false;
        while self.has_room() && self.budget > 0 {
            let most = self.budget.min(CHUNK);
            let count = bytes.get_mut(..most).map_or(0, |b| self.port.read(b));
            if count == 0 {
                has_all = true;
                break;
            }
            if stands("byte_budget") {
                self.budget = self.budget.saturating_sub(count);
            }
            let mut rest = bytes.get(..count).unwrap_or_default();
            while let Some(delivery) = self.endpoint.receive(&mut rest, now_us) {
                self.apply(delivery, &mut publish);
            }
        }
        // A `State` is longer than what a USB port takes at once: the rest follows when a packet has left.
        let port = &mut self.port;
        self.outbox.flush(|bytes| port.write(bytes));
        has_all
    }

    /// For all orders that a chunk may bring.
    fn has_room(&self) -> bool {
        self.orders.capacity() - self.orders.len() > CHUNK / SMALLEST_FRAME
            || !stands("room_for_orders")
    }

    fn apply(&mut self, delivery: Delivery, publish: &mut impl FnMut(&mut &'a mut Slot) -> bool) {
        match delivery {
            Delivery::Contact(contact) => {
                *self.back = Some(self.endpoint.fresh(contact));
                // What comes back is what was replaced.
                if publish(&mut self.back) && self.back.is_some() {
                    self.endpoint.count_superseded();
                }
            }
            Delivery::Order(order) => {
                if order.voids_contacts() {
                    // Forgotten, not replaced by a newer one.
                    *self.back = None;
                    publish(&mut self.back);
                }
                let refused = self.orders.enqueue(order).is_err();
                debug_assert!(!refused, "room was checked before the bytes were taken");
            }
        }
    }

    /// Whether a report follows this tick.
    pub fn report_is_due(&self, sample: &Sample) -> bool {
        self.endpoint.report_is_due(sample)
    }

    /// Sends what is due after a tick: the answer to a `Hello`, then `State`, `Pong`, `Report`. `clock_us` is the
    /// console's clock now. Returns whether a host was given a `Report`.
    pub fn send(&mut self, sample: &Sample, clock_us: u64) -> bool {
        self.budget = P::PER_TICK;
        let outbox = &mut self.outbox;
        let is_told = self
            .endpoint
            .send(sample, clock_us, |frame| outbox.push(frame));
        let port = &mut self.port;
        self.outbox.flush(|bytes| port.write(bytes));
        is_told
    }

    /// The port, for a board whose bytes come by other ways than interrupts.
    pub fn port(&mut self) -> &mut P {
        &mut self.port
    }

    /// Changes what every report says about this board.
    pub fn report(&mut self) -> &mut Report {
        self.endpoint.report()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exchange::Exchange;
    use std::vec::Vec;
    use sutura_shared::link::{EXPIRES_AFTER_US, HostEvent, HostLink, Identity, OWNED_FOR_US};
    use sutura_shared::wire::message::{Command, Contact, Ping, Row, Rows, State};
    use sutura_shared::wire::{List, MAX_FRAME, Message};

    /// Bytes in both directions, a few at a time.
    #[derive(Default)]
    struct Line {
        down: Vec<u8>,
        up: Vec<u8>,
        /// Most bytes that a read gives.
        grain: usize,
    }

    impl Bytes for Line {
        const PER_TICK: usize = 2000;

        fn read(&mut self, bytes: &mut [u8]) -> usize {
            let count = self.down.len().min(bytes.len()).min(self.grain);
            for (place, byte) in bytes.iter_mut().zip(self.down.drain(..count)) {
                *place = byte;
            }
            count
        }

        fn write(&mut self, bytes: &[u8]) -> usize {
            let count = bytes.len().min(self.grain);
            self.up.extend_from_slice(&bytes[..count]);
            count
        }
    }

    const IDENTITY: Identity = Identity {
        tick_hz: 1000,
        simulated: true,
        device_name: *b"test\0\0\0\0\0\0\0\0\0\0\0\0",
    };

    fn contact(force: f32) -> Contact {
        Contact {
            tool: 0,
            position_m: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench: [0.0, 0.0, force, 0.0, 0.0, 0.0],
            tangent: [0.0; 21],
            gap_m: 0.0,
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: 100_000,
        }
    }

    fn sample(tick: u32) -> Sample {
        let first = Sample::BEFORE_THE_FIRST;
        Sample {
            now_us: u64::from(tick) * 1000,
            state: State {
                tick,
                ..first.state
            },
            ..first
        }
    }

    /// Both sides, as the tasks use them; with an open session.
    struct Bench<'a> {
        side: HostSide<'a, Line>,
        contacts: Exchange<'a, Slot>,
        front: &'a mut Slot,
        orders: OrdersOut<'a>,
        host: HostLink,
        now_us: u64,
    }

    fn with_session(grain: usize, test: impl FnOnce(&mut Bench)) {
        let mut queue = Orders::new();
        let (orders_in, orders) = queue.split();
        let (mut back, mut middle, mut front) = (None, None, None);
        let line = Line {
            grain,
            ..Line::default()
        };
        let link = ConsoleLink::new(IDENTITY, 7);
        let side = HostSide::new(link, line, orders_in, &mut back, Report::default());
        let contacts = Exchange::new(&mut middle);
        let mut bench = Bench {
            side,
            contacts,
            front: &mut front,
            orders,
            host: HostLink::new(1000),
            now_us: 1000,
        };

        let mut frame = [0; MAX_FRAME];
        let length = bench.host.hello(3, &mut frame).expect("a hello fits");
        bench.down(&frame[..length]);
        bench.side.send(&sample(1), 1000);
        assert!(matches!(
            bench.up()[..],
            [
                HostEvent::Opened(_),
                HostEvent::State(_),
                HostEvent::Report(_)
            ]
        ));
        assert_eq!(bench.orders.dequeue(), Some(Order::OpenSession));
        test(&mut bench);
    }

    impl Bench<'_> {
        fn down(&mut self, bytes: &[u8]) {
            self.side.port.down.extend_from_slice(bytes);
            self.side
                .receive(self.now_us, |back| self.contacts.publish(back));
        }

        fn up(&mut self) -> Vec<HostEvent> {
            let bytes = core::mem::take(&mut self.side.port.up);
            bytes
                .iter()
                .filter_map(|&byte| self.host.receive(byte))
                .collect()
        }

        fn frame(&mut self, message: &impl Message) -> Vec<u8> {
            self.frame_at(1000, message)
        }

        fn frame_at(&mut self, time_us: u64, message: &impl Message) -> Vec<u8> {
            let mut frame = [0; MAX_FRAME];
            let length = self.host.send(time_us, message, &mut frame).expect("valid");
            frame[..length].to_vec()
        }
    }

    #[test]
    fn the_newest_contact_arrives_and_older_ones_are_counted() {
        for grain in [1, 7, 64] {
            with_session(grain, |bench| {
                for force in [1.0, 2.0, 3.0] {
                    let frame = bench.frame(&contact(force));
                    bench.down(&frame);
                }
                assert!(bench.contacts.take(&mut bench.front));
                let wrench = bench
                    .front
                    .as_ref()
                    .map(|fresh| fresh.contact.body().wrench[2]);
                assert_eq!(wrench, Some(3.0));
                assert_eq!(bench.side.report().frames_superseded, 2);
            });
        }
    }

    #[test]
    fn rows_come_with_the_contact_of_their_time() {
        with_session(64, |bench| {
            let rows = Rows {
                tool: 0,
                held: [0.0; 21],
                curvature_per_m: 0.0,
                rows: List::of([Row::default()]),
                compliance: List::of([0.01]),
            };
            // Rows, and the contact after them; some rows are lost.
            for (rows_us, contact_us, there) in [
                (Some(800), 800, 1),
                (None, 900, 0),
                (Some(850), 900, 0),
                (Some(900), 900, 1),
            ] {
                if let Some(rows_us) = rows_us {
                    let frame = bench.frame_at(rows_us, &rows);
                    bench.down(&frame);
                }
                let frame = bench.frame_at(contact_us, &contact(1.0));
                bench.down(&frame);
                assert!(bench.contacts.take(&mut bench.front));
                let fresh = bench.front.as_ref().expect("a contact");
                assert_eq!(fresh.rows.multipliers_n().count(), there);
            }
        });
    }

    #[test]
    fn a_new_session_forgets_the_contact_of_the_old_one() {
        with_session(64, |bench| {
            let frame = bench.frame(&contact(1.0));
            bench.down(&frame);
            let mut hello = [0; MAX_FRAME];
            let length = bench.host.hello(4, &mut hello).expect("a hello fits");
            bench.now_us += OWNED_FOR_US;
            bench.down(&hello[..length]);
            bench.contacts.take(&mut bench.front);
            assert_eq!(*bench.front, None);
            assert_eq!(
                bench.side.report().frames_superseded,
                0,
                "none was replaced"
            );
            assert_eq!(bench.orders.dequeue(), Some(Order::OpenSession));
        });
    }

    #[test]
    fn a_session_in_which_nothing_comes_is_closed_and_its_contact_forgotten() {
        with_session(64, |bench| {
            let frame = bench.frame(&contact(1.0));
            bench.down(&frame);
            bench.now_us += EXPIRES_AFTER_US - 1;
            bench.down(&[]);
            assert_eq!(bench.orders.dequeue(), None, "not yet");
            bench.now_us += 1;
            bench.down(&[]);
            assert_eq!(bench.orders.dequeue(), Some(Order::CloseSession));
            bench.contacts.take(&mut bench.front);
            assert_eq!(*bench.front, None);
            bench.side.send(&sample(2), bench.now_us);
            assert_eq!(bench.side.port.up, []);
        });
    }

    #[test]
    fn more_orders_than_there_is_room_for_wait_in_the_port() {
        with_session(64, |bench| {
            let mut frames = Vec::new();
            for ticks in 1..=40 {
                frames.extend(bench.frame(&Command::StateEvery { ticks }));
            }
            bench.down(&frames);
            let mut received = Vec::new();
            while let Some(order) = bench.orders.dequeue() {
                received.push(order);
                bench
                    .side
                    .receive(1000, |back| bench.contacts.publish(back));
            }
            let received = received.iter().map(|order| match order {
                Order::Command(command) => *command.body(),
                other => panic!("unexpected {other:?}"),
            });
            assert!(received.eq((1..=40).map(|ticks| Command::StateEvery { ticks })));
        });
    }

    /// The link task is not called again and again for what it cannot take: it says so, once.
    #[test]
    fn it_says_when_orders_must_be_taken_before_it_can_go_on() {
        with_session(64, |bench| {
            let mut frames = Vec::new();
            for ticks in 1..=20 {
                frames.extend(bench.frame(&Command::StateEvery { ticks }));
            }
            bench.side.port.down.extend_from_slice(&frames);
            let publish = |_: &mut &mut Slot| false;
            assert!(!bench.side.receive(1000, publish), "the queue is full");
            let left = bench.side.port.down.len();
            assert!(!bench.side.receive(1000, publish));
            assert_eq!(bench.side.port.down.len(), left, "nothing was taken");
            while bench.orders.dequeue().is_some() {}
            assert!(bench.side.receive(1000, publish), "all has been taken");
            assert!(bench.side.receive(1000, publish), "nothing was there");
        });
    }

    /// Noise as fast as a line can bring it: so many bytes a tick and no more, and nothing is lost.
    #[test]
    fn a_tick_has_a_budget_of_bytes() {
        with_session(64, |bench| {
            let publish = |_: &mut &mut Slot| false;
            bench.side.send(&sample(2), 2000);
            bench.side.port.down = std::vec![0xA5; 5000];
            for (left, has_all) in [(3000, false), (3000, false)] {
                assert_eq!(bench.side.receive(2000, publish), has_all);
                assert_eq!(bench.side.port.down.len(), left);
            }
            for (tick, left, has_all) in [(3, 1000, false), (4, 0, true)] {
                bench.side.send(&sample(tick), 1000 * u64::from(tick));
                assert_eq!(bench.side.receive(2000, publish), has_all);
                assert_eq!(bench.side.port.down.len(), left);
            }
        });
    }

    #[test]
    fn states_come_as_often_as_asked_and_reports_every_second() {
        with_session(64, |bench| {
            let frame = bench.frame(&Command::StateEvery { ticks: 10 });
            bench.down(&frame);
            let (mut states, mut reports) = (0, Vec::new());
            for tick in 2..=2000 {
                if tick % 500 == 0 {
                    // A live host.
                    bench.now_us = u64::from(tick) * 1000;
                    let ping = bench.frame(&Ping { host_us: 0 });
                    bench.down(&ping);
                }
                bench.side.send(&sample(tick), u64::from(tick) * 1000);
                for event in bench.up() {
                    match event {
                        HostEvent::State(_) => states += 1,
                        HostEvent::Report(report) => reports.push(*report.body()),
                        HostEvent::Pong(_) => {}
                        other => panic!("unexpected {other:?}"),
                    }
                }
            }
            assert_eq!(states, 200);
            assert_eq!(reports.len(), 2);
            assert_eq!(reports[1].ticks, 2000);
            // The hello, the command and four pings.
            assert_eq!(
                (reports[1].frames_received, reports[1].frames_rejected),
                (6, 0)
            );
        });
    }
}
