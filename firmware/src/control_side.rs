//! One control tick with everything around it that is not the shared code's: what the control task runs.
//!
//! Entry point: [`ControlSide::tick`]. Nothing here waits, allocates or logs.

use crate::exchange::Exchange;
use crate::host_side::{OrdersOut, Slot};
use sutura_shared::console_endpoint::{Costs, Sample};
use sutura_shared::control::{Control, TICK_US, TickInput, TickOutput};
use sutura_shared::wire::message::Simulate;

/// Encoders, motors and switches of a console, real or simulated.
pub trait Plant {
    /// Reads the inputs of this tick; `overrun`: the last one took longer than its period.
    fn read(&mut self, overrun: bool) -> TickInput;
    /// Commands the motors.
    fn write(&mut self, output: &TickOutput);
    /// Whether this tick has taken longer than its period by now.
    fn overrun(&self) -> bool;
    /// An order to a simulated console; a real one never gets any.
    fn simulate(&mut self, order: &Simulate, control: &mut Control);
}

/// The control loop and the ends of what leads to it.
pub struct ControlSide<'a, P> {
    control: Control,
    plant: P,
    orders: OrdersOut<'a>,
    front: &'a mut Slot,
    fresh: bool,
    sample: &'a mut Sample,
    overrun: bool,
    /// Console time of the last tick; 0 before the first.
    last_us: u64,
    costs: Costs,
}

impl<'a, P: Plant> ControlSide<'a, P> {
    /// `front`: the reader's buffer of the exchange of contacts; `sample`: the writer's of the other one.
    pub fn new(
        control: Control,
        plant: P,
        orders: OrdersOut<'a>,
        front: &'a mut Slot,
        sample: &'a mut Sample,
    ) -> Self {
        Self {
            control,
            plant,
            orders,
            front,
            fresh: false,
            sample,
            overrun: false,
            last_us: 0,
            costs: Costs::default(),
        }
    }

    /// Takes the newest contact, if there is one. Under the lock: one swap.
    pub fn take(&mut self, contacts: &mut Exchange<'a, Slot>) {
        self.fresh = contacts.take(&mut self.front);
    }

    /// Runs one tick and returns its console time \[us\].
    pub fn tick(&mut self) -> u64 {
        while let Some(order) = self.orders.dequeue() {
            let plant = &mut self.plant;
            order.obey(&mut self.control, |order, control| {
                plant.simulate(order, control);
            });
        }
        let input = self.plant.read(self.overrun);
        let fresh = if self.fresh {
            self.front.as_ref()
        } else {
            None
        };
        let output = self.control.tick(&input, fresh);
        self.plant.write(&output);
        self.overrun = self.plant.overrun();
        let late = self.last_us != 0 && input.now_us >= self.last_us + 2 * TICK_US;
        self.costs.late = self.costs.late.wrapping_add(u32::from(late));
        self.last_us = input.now_us;
        *self.sample = Sample {
            now_us: input.now_us,
            state: output.state,
            costs: self.costs,
        };
        input.now_us
    }

    /// Hands the tick's outcome over. Under the lock: one swap.
    pub fn give(&mut self, samples: &mut Exchange<'a, Sample>) {
        samples.publish(&mut self.sample);
    }

    /// Counts what the tick cost, in the board's unit; to be called after everything else.
    pub fn finish(&mut self, cost: u32) {
        self.costs.overruns = self.costs.overruns.wrapping_add(u32::from(self.overrun));
        self.costs.cost_max = self.costs.cost_max.max(cost);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::devices::CARTESIAN_BENCH;
    use crate::drivers::angle::AngleEncoder;
    use crate::drivers::angle::tests::Bus;
    use crate::host_side::{Bytes, HostSide, Orders};
    use std::vec::Vec;
    use sutura_shared::control::TICK_HZ;
    use sutura_shared::device::JOINTS;
    use sutura_shared::link::{ConsoleLink, HostEvent, HostLink, Identity};
    use sutura_shared::simulated_console::{Pace, SimulatedBoard, SimulatedConsole};
    use sutura_shared::wire::message::{
        Command, Contact, Course, End, Friction, HandScript, Mode, Needle, Ping, Report, Row,
        RowKind, Rows, State, Tension, Thread, Tip, WAY_POINTS, WayPoint,
    };
    use sutura_shared::wire::{List, MAX_FRAME, Message, faults};

    #[derive(Default)]
    struct Line {
        down: Vec<u8>,
        up: Vec<u8>,
    }

    impl Bytes for Line {
        fn read(&mut self, bytes: &mut [u8]) -> usize {
            let count = self.down.len().min(bytes.len());
            for (place, byte) in bytes.iter_mut().zip(self.down.drain(..count)) {
                *place = byte;
            }
            count
        }

        fn write(&mut self, bytes: &[u8]) -> usize {
            self.up.extend_from_slice(bytes);
            bytes.len()
        }
    }

    /// What a host sends before tick `tick`: every kind of message, several in one tick, noise, silence,
    /// and a second session.
    fn script(host: &mut HostLink, tick: u32, newest: Option<(u64, State)>) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut frame = [0; MAX_FRAME];
        // Another host, which comes too early, when the first one has been quiet, and when that has been forgotten.
        if matches!(tick, 3 | 2100 | 2500 | 4200) {
            if tick == 2100 {
                // The answer is not for this host: it keeps its session.
                let length = HostLink::new(TICK_HZ).hello(tick, &mut frame);
                bytes.extend_from_slice(&frame[..length.expect("a hello fits")]);
                return bytes;
            }
            let length = host.hello(tick, &mut frame).expect("a hello fits");
            bytes.extend_from_slice(&frame[..length]);
        }
        if (2150..2500).contains(&tick) || (3100..4200).contains(&tick) {
            return bytes;
        }
        let mut send = |time, message: Order| {
            fn one(host: &mut HostLink, time: u64, body: &impl Message, out: &mut Vec<u8>) {
                let mut frame = [0; MAX_FRAME];
                if let Ok(length) = host.send(time, body, &mut frame) {
                    out.extend_from_slice(&frame[..length]);
                }
            }
            match message {
                Order::Ping(ping) => one(host, time, &ping, &mut bytes),
                Order::Command(command) => one(host, time, &command, &mut bytes),
                Order::Simulate(order) => one(host, time, &order, &mut bytes),
                Order::Contact(contact) => one(host, time, &contact, &mut bytes),
                Order::Rows(rows) => one(host, time, &rows, &mut bytes),
                Order::Needle(needle) => one(host, time, &needle, &mut bytes),
                Order::Thread(thread) => one(host, time, &thread, &mut bytes),
            }
        };
        match tick {
            10 | 2510 => {
                send(0, Order::Simulate(Simulate::Device(CARTESIAN_BENCH)));
                send(0, Order::Simulate(Simulate::Hand(hand())));
            }
            20 | 2520 | 1900 => send(0, Order::Command(Command::Arm)),
            1000 => send(0, Order::Command(Command::StateEvery { ticks: 7 })),
            1800 => send(0, Order::Simulate(Simulate::EmergencyStop(true))),
            1810 => send(0, Order::Simulate(Simulate::EmergencyStop(false))),
            1820 => send(0, Order::Command(Command::ClearFault)),
            _ if tick.is_multiple_of(100) => send(
                0,
                Order::Ping(Ping {
                    host_us: u64::from(tick),
                }),
            ),
            _ => {}
        }
        // 60 Hz contacts, twice in some ticks; none for 300 ms.
        if let Some((time, state)) = newest
            && tick.is_multiple_of(16)
            && !(1200..1500).contains(&tick)
        {
            // Every fourth is lost.
            if !tick.is_multiple_of(64) {
                send(time, Order::Rows(rows(&state)));
            }
            send(time, Order::Needle(needle()));
            send(time, Order::Thread(thread()));
            send(time, Order::Contact(contact(&state)));
            if tick.is_multiple_of(48) {
                send(time, Order::Contact(contact(&state)));
            }
        }
        if tick.is_multiple_of(311) {
            bytes.extend([1, 2, 3, 0, 0, 7]);
        }
        bytes
    }
    #[allow(clippy::large_enum_variant, reason = "a test's script, one at a time")]
    enum Order {
        Ping(Ping),
        Command(Command),
        Simulate(Simulate),
        Contact(Contact),
        Rows(Rows),
        Needle(Needle),
        Thread(Thread),
    }

    fn hand() -> HandScript {
        let mut way_points = [WayPoint::default(); WAY_POINTS];
        way_points[1] = WayPoint {
            time_s: 1.0,
            position_m: [0.002, -0.001, -0.01],
        };
        way_points[2] = WayPoint {
            time_s: 2.0,
            position_m: [0.0, 0.0, 0.005],
        };
        HandScript {
            stiffness_n_per_m: 300.0,
            damping_n_s_per_m: 3.0,
            start_joint: [0.0; 3],
            count: 3,
            way_points,
        }
    }

    /// A floor of 500 N/m at z = 0, solved at the state's pose.
    fn contact(state: &State) -> Contact {
        let depth = -state.position_m[2];
        let mut tangent = [0.0; 21];
        tangent[11] = -500.0;
        Contact {
            tool: 0,
            position_m: state.position_m,
            orientation: state.orientation,
            wrench: [0.0, 0.0, 500.0 * depth.max(0.0), 0.0, 0.0, 0.0],
            tangent,
            gap_m: (-depth).max(0.0),
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: 60_000,
        }
    }

    /// That floor as a row.
    fn rows(state: &State) -> Rows {
        let height = state.position_m[2];
        let row = Row {
            kind: RowKind::Smooth { id: 1 },
            delta_free_m: height,
            lambda_n: 500.0 * (-height).max(0.0),
            jacobian: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        };
        Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 0.0,
            rows: List::of([row]),
            compliance: List::of([1.0 / 500.0]),
        }
    }

    /// A needle that hangs in the grip.
    fn needle() -> Needle {
        Needle {
            tool: 0,
            needle: 0,
            slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
            tip: Tip::Outside,
            friction: Friction::Sticks,
            axial_n: 0.0,
            friction_n: [0.0; 2],
            stiffness_n_per_m: [0.0; 2],
            hold_n: 0.0,
            puncture_n: 0.25,
            punctured_n: 0.0,
            course: Course::default(),
        }
    }

    /// Its thread, taut.
    fn thread() -> Thread {
        Thread {
            tool: 0,
            thread: 0,
            end: End::Head,
            state: Tension::Taut,
            direction: [0.0, 0.0, 1.0],
            tension_n: 0.5,
            stiffness_n_per_m: 100.0,
            slack_m: 0.0,
        }
    }

    /// A board on which ticks take as long as they are told to.
    #[derive(Default)]
    struct Slow {
        now_us: u64,
        /// What `read` was told.
        told: Vec<bool>,
        /// Durations of the ticks to come \[us\], from the end on.
        durations_us: Vec<u64>,
    }

    /// Its time is made by the ticks themselves.
    impl Plant for SimulatedBoard {
        fn read(&mut self, overrun: bool) -> TickInput {
            self.read(overrun)
        }

        fn write(&mut self, output: &TickOutput) {
            self.write(output);
        }

        fn overrun(&self) -> bool {
            false
        }

        fn simulate(&mut self, order: &Simulate, control: &mut Control) {
            self.simulate(order, control);
        }
    }

    impl Plant for Slow {
        fn read(&mut self, overrun: bool) -> TickInput {
            self.told.push(overrun);
            TickInput {
                now_us: self.now_us,
                ..TickInput::default()
            }
        }

        fn write(&mut self, _: &TickOutput) {
            let took = self.durations_us.pop().unwrap_or(1000);
            self.now_us += took.max(TICK_US);
        }

        fn overrun(&self) -> bool {
            !self.now_us.is_multiple_of(TICK_US)
        }

        fn simulate(&mut self, _: &Simulate, _: &mut Control) {}
    }

    #[test]
    fn overruns_reach_the_next_tick_and_late_ticks_are_counted() {
        let mut queue = Orders::new();
        let (_, orders_out) = queue.split();
        let mut front = None;
        let mut sample = Sample::BEFORE_THE_FIRST;
        let control = Control::new(CARTESIAN_BENCH).expect("a valid device");
        // On time; 0.2 ms over, so that the next one begins at once; a whole period lost; on time.
        let plant = Slow {
            now_us: 1000,
            durations_us: std::vec![1000, 2000, 1800, 1200, 1000],
            ..Slow::default()
        };
        let mut side = ControlSide::new(control, plant, orders_out, &mut front, &mut sample);
        for _ in 0..6 {
            side.tick();
            side.finish(7);
        }
        assert_eq!(side.plant.told, [false, false, true, false, false, false]);
        assert_eq!(
            side.costs,
            Costs {
                overruns: 1,
                late: 1,
                cost_max: 7
            }
        );
    }

    /// A simulated board whose joints have angle sensors on a bus each.
    struct OverSpi {
        board: SimulatedBoard,
        buses: [Bus; JOINTS],
        encoders: [AngleEncoder<Bus>; JOINTS],
    }

    impl OverSpi {
        fn new(board: SimulatedBoard) -> Self {
            let buses = [(); JOINTS].map(|()| Bus::new());
            // 2 m/s at 81 counts a millimetre.
            let encoders = buses.clone().map(|bus| AngleEncoder::new(bus, 164));
            OverSpi {
                board,
                buses,
                encoders,
            }
        }
    }

    impl Plant for OverSpi {
        fn read(&mut self, overrun: bool) -> TickInput {
            let mut input = self.board.read(overrun);
            let joints = self.buses.iter().zip(&mut self.encoders);
            for ((bus, encoder), counts) in joints.zip(&mut input.encoder_counts) {
                bus.0.borrow_mut().angle = counts.rem_euclid(1 << 14) as u16;
                let angle = encoder.tick();
                *counts = angle.counts;
                input.board_fault |= angle.broken;
            }
            input
        }

        fn write(&mut self, output: &TickOutput) {
            self.board.write(output);
        }

        fn overrun(&self) -> bool {
            false
        }

        fn simulate(&mut self, order: &Simulate, control: &mut Control) {
            let before = self.board.device().encoder_counts();
            self.board.simulate(order, control);
            // Another device has sensors that start again.
            if self.board.device().encoder_counts() != before {
                let buses = self.buses.clone();
                self.encoders = buses.map(|bus| AngleEncoder::new(bus, 164));
            }
        }
    }

    /// The tasks' parts, run in the order of their priorities, are `SimulatedConsole` to the byte.
    #[test]
    fn the_tasks_give_the_bytes_of_the_simulated_console() {
        compare_with_the_simulated_console(SimulatedBoard::new(&CARTESIAN_BENCH));
    }

    /// Sessions, faults and all: angles over a bus are counts to the bit.
    #[test]
    fn encoders_over_spi_give_the_bytes_of_encoders_that_count() {
        let board = SimulatedBoard::new(&CARTESIAN_BENCH);
        compare_with_the_simulated_console(OverSpi::new(board));
    }

    #[test]
    fn a_sensor_that_is_gone_is_a_fault_of_the_board_in_the_third_tick() {
        let mut queue = Orders::new();
        let (_, orders_out) = queue.split();
        let mut front = None;
        let mut sample = Sample::BEFORE_THE_FIRST;
        let mut control = Control::new(CARTESIAN_BENCH).expect("a valid device");
        control.command(Command::Arm);
        let plant = OverSpi::new(SimulatedBoard::new(&CARTESIAN_BENCH));
        let mut side = ControlSide::new(control, plant, orders_out, &mut front, &mut sample);
        for _ in 0..400 {
            side.tick();
        }
        side.plant.buses[1].0.borrow_mut().stuck = Some(u16::MAX);
        let modes = [(); 3].map(|()| {
            side.tick();
            (side.sample.state.mode, side.sample.state.faults)
        });
        let armed = (Mode::Armed, 0);
        assert_eq!(modes, [armed, armed, (Mode::Fault, faults::BOARD)]);
        assert_eq!(side.sample.state.current_a, [0.0; JOINTS]);
    }

    fn compare_with_the_simulated_console(plant: impl Plant) {
        let identity = Identity {
            tick_hz: TICK_HZ,
            simulated: true,
            device_name: CARTESIAN_BENCH.name,
        };
        let mut queue = Orders::new();
        let (orders_in, orders_out) = queue.split();
        let (mut back, mut middle, mut front) = (None, None, None);
        let [mut written, mut between, mut newest] = [Sample::BEFORE_THE_FIRST; 3];
        let link = ConsoleLink::new(identity, 0);
        let mut host_side = HostSide::new(
            link,
            Line::default(),
            orders_in,
            &mut back,
            Report::default(),
        );
        let mut contacts = Exchange::new(&mut middle);
        let mut samples = Exchange::new(&mut between);
        let control = Control::new(CARTESIAN_BENCH).expect("a valid device");
        let mut control_side =
            ControlSide::new(control, plant, orders_out, &mut front, &mut written);
        let mut newest = &mut newest;

        let mut reference = SimulatedConsole::new(&CARTESIAN_BENCH, 0).expect("a valid device");
        let mut host = HostLink::new(TICK_HZ);
        let mut last: Option<(u64, State)> = None;
        let mut modes = Vec::new();
        let mut peak = 0.0_f32;
        let mut now_us = 0;
        let mut silent = 0;
        for tick in 1..=4500 {
            let down = script(&mut host, tick, last);

            host_side.port().down.extend_from_slice(&down);
            assert!(host_side.receive(now_us, |back| contacts.publish(back)));
            control_side.take(&mut contacts);
            now_us = control_side.tick();
            control_side.give(&mut samples);
            assert!(samples.take(&mut newest));
            host_side.send(newest, now_us);
            let up = core::mem::take(&mut host_side.port().up);

            reference.feed(&down);
            reference.tick(Pace::default());
            let mut expected = Vec::new();
            reference.drain(&mut expected);
            assert_eq!(up, expected, "tick {tick}");
            silent += u32::from(tick > 3 && up.is_empty());

            for byte in up {
                if let Some(HostEvent::State(state)) = host.receive(byte) {
                    last = Some((state.console_time_us(), *state.body()));
                    peak = peak.max(state.body().force_n[2]);
                    if modes.last() != Some(&state.body().mode) {
                        modes.push(state.body().mode);
                    }
                }
            }
        }
        // The script is worth something only if it went through everything.
        for mode in [Mode::Idle, Mode::Armed, Mode::Decaying, Mode::Fault] {
            assert!(modes.contains(&mode), "{modes:?}");
        }
        assert!(peak > 1.0, "{peak} N");
        // From a second after the last frame until the third session; between states of every seventh tick.
        assert!(silent > 100, "{silent}");
    }
}
