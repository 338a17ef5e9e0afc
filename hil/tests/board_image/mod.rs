//! The images for boards with motors, as they are flashed, under QEMU: see `sutura_hil::board_image`. Nothing here looks at a clock.

#![allow(clippy::unwrap_used, reason = "a test")]

/// The test of this name, on each board as it is flashed.
macro_rules! on_each_board {
    ($test:ident) => {
        on_each_board!($test: olimex_h405 OLIMEX_H405, nucleo_f446ze NUCLEO_F446ZE);
    };
    ($test:ident: $($name:ident $board:ident),*) => {
        mod $test {
            $(#[test]
            fn $name() {
                super::$test(super::On::flashed(sutura_hil::board_image::Board::$board));
            })*
        }
    };
}

mod fitted;
mod guards;
mod link;
mod loader;
mod log;
mod mutants;
mod pins;
mod registers;
mod resets;
mod selftest;
mod sessions;
mod traffic;

use std::time::Duration;
use sutura_hil::board_image::{Board, BoardImage, BoardImageError, Outputs, RANDOM};
use sutura_hil::board_image::{default_image, default_mutants, provenance};
use sutura_host::scene::{Document, read_device};
use sutura_shared::console_endpoint::{ConsoleEndpoint, Delivery};
use sutura_shared::control::{Control, Fresh, TickInput};
use sutura_shared::device::DeviceDescription;
use sutura_shared::link::{ConsoleLink, HostEvent, HostLink, Identity};
use sutura_shared::wire::message::{Command, Contact, Hello, Mode, Report, State};
use sutura_shared::wire::{MAX_FRAME, Message, Valid};

/// Whether everything runs in its long form.
fn is_full() -> bool {
    std::env::var_os("SUTURA_FULL").is_some_and(|value| value == "1")
}

/// For a run that hangs, on a machine that does other things; the long form takes twenty times as long.
fn time_limit() -> Duration {
    Duration::from_secs(if is_full() { 30_000 } else { 1500 })
}

/// The device file that a session with this board needs: the image has the same numbers compiled in, or bits differ.
fn device(on: On) -> DeviceDescription {
    let devices = concat!(env!("CARGO_MANIFEST_DIR"), "/../devices");
    let path = format!("{devices}/{}.toml", on.name());
    read_device(&Document::read(path.as_ref()).unwrap())
        .unwrap()
        .description
}

/// Bytes that the image takes in a tick for sure, in whole packets: what is sent with them is with the twin in the same tick.
const TAKEN: usize = 704;
/// Compare value of no current.
const NO_CURRENT: u32 = 21_000;
const DARK: Outputs = Outputs {
    enable: false,
    pulses: false,
    duty: [NO_CURRENT; 3],
};

/// Compare value of a current \[A\]: 10 to 90 % of 42000 counts for minus to plus 5 A.
fn duty(current_a: f32) -> u32 {
    let share = (current_a / 5.0).clamp(-1.0, 1.0);
    ((0.5 + 0.4 * share) * 42_000.0 + 0.5) as u32
}

type PowerUp = fn(Board, std::path::PathBuf, Duration) -> Result<BoardImage, BoardImageError>;

/// What a check runs.
#[derive(Clone, Copy, Debug)]
struct On {
    board: Board,
    /// The image that can go without a guard, and which it is to go without; else the one that is flashed.
    mutant: Option<Option<&'static str>>,
}

impl On {
    /// The image that is flashed.
    fn flashed(board: Board) -> On {
        On {
            board,
            mutant: None,
        }
    }

    /// That of a NUCLEO with everything on it, which no console is flashed with.
    const FITTED: On = On {
        board: Board::NUCLEO_F446ZE,
        mutant: Some(None),
    };

    /// The one that can go without a guard.
    fn mutant(board: Board, without: Option<&'static str>) -> On {
        On {
            board,
            mutant: Some(without),
        }
    }

    fn name(self) -> &'static str {
        self.board.name()
    }

    /// Before its first instruction.
    fn power_up(self) -> BoardImage {
        self.power(BoardImage::power_up)
    }

    /// Where its image is.
    fn image(self) -> std::path::PathBuf {
        match self.mutant {
            None => default_image(self.board),
            Some(_) => default_mutants(self.board),
        }
    }

    fn power(self, up: PowerUp) -> BoardImage {
        let image = known(&self.image());
        let board = up(self.board, image.clone(), time_limit());
        let mut board = board.unwrap_or_else(|error| panic!("{error}"));
        if let Some(guard) = self.mutant {
            let out = board.take_out(&image, guard);
            out.unwrap_or_else(|error| panic!("{error}"));
            if self.board == Board::NUCLEO_F446ZE {
                board.fit().unwrap_or_else(|error| panic!("{error}"));
            }
        }
        board
    }

    /// Before its first instruction, with every instruction counted.
    fn power_up_counting(self) -> BoardImage {
        self.power(BoardImage::power_up_counting)
    }

    /// Booted.
    fn start(self) -> BoardImage {
        let mut board = self.power_up();
        board.boot().unwrap_or_else(|error| panic!("{error}"));
        board
    }
}

/// An image that is what these sources make.
fn known(image: &std::path::Path) -> std::path::PathBuf {
    let known = provenance(image).unwrap_or_else(|error| panic!("{error}"));
    eprintln!("sha256 {} of {} files", known.sha256, known.sources);
    known.image
}

/// The same control loop and link in this process: what the image is compared with, tick by tick.
struct Twin {
    endpoint: ConsoleEndpoint,
    control: Control,
    fresh: Option<Fresh>,
    now_us: u64,
}

impl Twin {
    fn new(on: On, seed: u32) -> Twin {
        let identity = Identity {
            tick_hz: 1000,
            simulated: false,
            device_name: device(on).name,
        };
        let link = ConsoleLink::new(identity, seed);
        Twin {
            endpoint: ConsoleEndpoint::new(link, Report::default()),
            control: Control::new(device(on)).unwrap(),
            fresh: None,
            now_us: 0,
        }
    }

    fn receive(&mut self, bytes: &[u8]) {
        let expired = self.endpoint.expire(self.now_us);
        expired
            .into_iter()
            .for_each(|delivery| self.apply(delivery));
        let mut rest = bytes;
        while let Some(delivery) = self.endpoint.receive(&mut rest, self.now_us) {
            self.apply(delivery);
        }
    }

    fn apply(&mut self, delivery: Delivery) {
        match delivery {
            Delivery::Contact(contact) => self.fresh = Some(self.endpoint.fresh(contact)),
            Delivery::Order(order) => {
                if order.voids_contacts() {
                    self.fresh = None;
                }
                order.obey(&mut self.control, |_, _| {});
            }
        }
    }

    fn tick(&mut self, input: &TickInput) -> State {
        let fresh = self.fresh.take();
        self.now_us = input.now_us;
        self.control.tick(input, fresh.as_ref()).state
    }
}

/// The seed that the first session's number was made from: MurmurHash3's finalizer, the other way round (see `ConsoleLink`).
fn seed_of(hello: &Hello) -> u32 {
    let mut x = hello.session;
    x ^= x >> 16;
    x = x.wrapping_mul(0x7ed1_b41d);
    x ^= x >> 13 ^ x >> 26;
    x = x.wrapping_mul(0xa5cb_9243);
    x ^= x >> 16;
    (x.wrapping_sub(0x9e37_79b9) ^ hello.nonce).rotate_right(16)
}

/// The image with a host on its USB port.
struct Bench {
    on: On,
    board: BoardImage,
    twin: Twin,
    host: HostLink,
    hello: Option<Hello>,
    report: Option<Report>,
    /// The newest state, and its console time \[us\].
    state: Option<(u64, State)>,
    /// Bytes for the next tick.
    down: Vec<u8>,
    /// Whether every state is compared with the twin's, and the outputs with its currents.
    compares: bool,
    compared: u32,
    /// Ticks of this boot.
    booted: u64,
    /// What the image has drawn for its sessions.
    seed: u32,
}

impl Bench {
    /// A console that has been plugged in and has answered a host.
    fn start(on: On) -> Bench {
        let mut bench = Bench::of(on, on.start());
        bench.open();
        bench
    }

    fn of(on: On, board: BoardImage) -> Bench {
        let booted = board.ticks() - 1;
        Bench {
            board,
            on,
            twin: Twin::new(on, RANDOM),
            host: HostLink::new(1000),
            hello: None,
            report: None,
            state: None,
            down: Vec::new(),
            compares: true,
            compared: 0,
            booted,
            seed: 0,
        }
    }

    /// Plugs the cable in, says hello, and waits for the answer.
    fn open(&mut self) {
        self.board.enumerate().unwrap_or_else(|e| panic!("{e}"));
        self.hello();
        self.tick();
        assert!(self.hello.is_some() && self.state.is_some(), "no answer");
        assert!(self.report.is_some(), "no report beside it");
    }

    fn hello(&mut self) {
        // Ticks before a host came: nothing but time.
        for tick in 1..=self.board.ticks() - self.booted {
            self.twin.tick(&TickInput {
                now_us: 1000 * tick,
                amplifiers_unready: true,
                ..TickInput::default()
            });
        }
        self.say_hello();
    }

    /// A host's first frame, for the next tick.
    fn say_hello(&mut self) {
        let mut frame = [0; MAX_FRAME];
        let length = self.host.hello(7, &mut frame).unwrap();
        self.down.push(0);
        self.down.extend_from_slice(&frame[..length]);
    }

    /// A frame of the session, for the next tick, at the newest state's time.
    fn say(&mut self, message: &impl Message) {
        let mut frame = [0; MAX_FRAME];
        let time = self.state.map_or(0, |(time, _)| time);
        let length = self.host.send(time, message, &mut frame).unwrap();
        self.down.extend_from_slice(&frame[..length]);
    }

    /// One tick; the state that it ended in.
    fn tick(&mut self) -> State {
        let before = self.state.map(|(time, _)| time);
        let ticked = self.try_tick();
        ticked.unwrap_or_else(|error| panic!("{error}"));
        let (time, state) = self.state.unwrap();
        assert_ne!(before, Some(time), "no state has come");
        state
    }

    fn try_tick(&mut self) -> Result<(), BoardImageError> {
        let most = if self.compares { TAKEN } else { usize::MAX };
        let down: Vec<u8> = self.down.drain(..self.down.len().min(most)).collect();
        self.board.send(&down);
        self.board.tick()?;
        let up = self.board.take();
        let events: Vec<_> = up
            .iter()
            .filter_map(|byte| self.host.receive(*byte))
            .collect();
        if self.hello.is_none() {
            self.learn_seed(&events);
        }
        self.twin.receive(&down);
        for event in events {
            match Some(event) {
                Some(HostEvent::State(state)) => self.took(&state),
                Some(HostEvent::Opened(hello)) => self.hello = Some(hello),
                Some(HostEvent::Report(report)) => self.report = Some(*report.body()),
                Some(HostEvent::Pong(_)) | None => {}
                Some(other) => panic!("{other:?}"),
            }
        }
        Ok(())
    }

    /// The first answer tells what the image has drawn; the twin draws the same.
    fn learn_seed(&mut self, events: &[HostEvent]) {
        for event in events {
            let HostEvent::Opened(hello) = event else {
                continue;
            };
            let seed = seed_of(hello);
            if self.on.board.draws() {
                assert_eq!(seed, RANDOM, "what the generator gave");
            }
            self.seed = seed;
            self.twin.endpoint = Twin::new(self.on, seed).endpoint;
        }
    }

    /// A state has come: what the same tick gives here, and what is on the pins.
    fn took(&mut self, state: &Valid<State>) {
        let body = *state.body();
        self.state = Some((state.console_time_us(), body));
        if !self.compares {
            return;
        }
        assert_eq!(body.encoder_counts, self.board.chip().lines.encoder_counts);
        let own = self.twin.tick(&TickInput::of(state));
        // To the bit: the hash is over all outputs and the state within.
        assert_eq!(body.trace_hash, own.trace_hash, "{body:?}\nhere: {own:?}");
        assert_eq!(body, own);
        assert_eq!(self.board.chip().outputs().duty, body.current_a.map(duty));
        self.compared += 1;
    }

    /// Ticks until the amplifiers are on and take currents.
    fn arm(&mut self) {
        self.say(&Command::Arm);
        for _ in 0..25 {
            let state = self.tick();
            assert_eq!((state.mode, state.faults), (Mode::Armed, 0));
        }
        assert!(self.board.chip().outputs().enable, "not after 25 ms");
    }

    /// Arms, presses 1 mm deep into a floor of 2 kN/m, and stays there.
    fn push(&mut self) {
        self.arm();
        for tick in 0..=40 {
            if tick % 8 == 0 {
                let contact = self.floor();
                self.say(&contact);
            }
            self.board.chip().lines.encoder_counts[2] = -5 * tick;
            self.tick();
        }
        assert!(self.pushes(), "{:?}", self.state);
    }

    fn pushes(&self) -> bool {
        let (_, state) = self.state.unwrap();
        state.force_n[2] > 1.0
    }

    /// A floor of 2 kN/m at z = 0, solved at the newest state's pose, good for 100 ms.
    fn floor(&self) -> Contact {
        let (_, state) = self.state.unwrap();
        let depth = -state.position_m[2];
        let mut tangent = [0.0; 21];
        tangent[11] = -2000.0;
        Contact {
            tool: 0,
            position_m: state.position_m,
            orientation: state.orientation,
            wrench: [0.0, 0.0, 2000.0 * depth.max(0.0), 0.0, 0.0, 0.0],
            tangent,
            gap_m: (-depth).max(0.0),
            normal: [0.0, 0.0, 1.0],
            relaxation_per_s: 0.0,
            horizon_us: 100_000,
        }
    }

    /// The changes of the outputs since this was last asked.
    fn changes(&mut self) -> Vec<Outputs> {
        std::mem::take(&mut self.board.chip().changes)
    }

    fn outputs(&mut self) -> Outputs {
        self.board.chip().outputs()
    }

    fn say_speed(&self, what: &str) {
        eprintln!(
            "{what}: {}; {} ticks compared",
            self.board.speed(),
            self.compared
        );
    }
}
