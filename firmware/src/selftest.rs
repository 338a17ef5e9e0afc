//! What a bare board with a few jumpers can find out about itself, without amplifiers: one line a check, with its figure.
//!
//! Entry point: [`SelfTest::tick`], once a tick. It asks a board through [`Rig`], so that the order of checks and every verdict are tested on
//! the build machine. Jumpers: PC6 to A and PC7 to B of all three encoders, PC8 to PA6, enable to PB9, and nothing else on any of them.
//! Enable is PA8 of the H405, PE9 of the NUCLEO.
//!
//! Lines: `pass NAME FIGURE`, `FAIL NAME FIGURE`, `untimed NAME FIGURE` where the cycle counter stands, as it does under an emulator.
//! What the host has to do is asked for by `send BYTES` and `next NAME`: bytes of [`PATTERN`], and to open the port again after a reset and
//! say [`GO_ON`].

use core::fmt::{Arguments, Write};
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use heapless::{String, Vec};

/// A line of the report.
pub type Line = String<96>;
/// Lines of a tick, in order.
pub type Lines = Vec<Line, 3>;

/// What the host says to begin,
pub const BEGIN: u8 = b't';
/// and to go on after a reset.
pub const GO_ON: u8 = b'c';

/// Edges that a check of encoders makes: four counts in a hundred periods.
const EDGES: i32 = 400;
/// Ticks over which the clocks are looked at.
const CLOCK_TICKS: u16 = 500;
/// Cycles of a tick, and how far a single one may be off: an interrupt's entry, twice over, and what locks hold.
const TICK_CYCLES: u32 = 168_000;
const JITTER_CYCLES: u32 = 2_000;
/// Longest time from the stop line's opening until enable is low: a microsecond, which is the pins' and the timer's own many times.
const CUT_CYCLES: u32 = 168;
/// Most cycles of a control tick: a fifth is left for the link and telemetry.
const MOST_CYCLES: u32 = TICK_CYCLES / 5 * 4;
/// Fewest frames of rows a second that a board has to take: a host of 100 Hz.
const FEWEST_ROWS: u32 = 100;
/// Bytes that are sent over USB, each way.
const BULK: u32 = 16_384;
/// Slowest rate \[kB/s\]: a session at 1 kHz has 183 down and 115 up.
const SLOWEST: u32 = 200;
/// Ticks after which nothing more comes.
const PATIENCE: u16 = 5000;
/// Ticks without a word, after which what was said before has gone through the cable.
const QUIET: u16 = 50;
/// Ticks after which a watchdog does not bite any more.
const NO_BITE: u16 = 300;

/// Numbers of `Report::reset_cause` and `Report::epitaph_kind`.
const BY_WATCHDOG: u8 = 4;
const BY_HANDLER: u8 = 5;
const EXCEPTION: u8 = 3;
const WARNED: u8 = 4;
/// Place of an epitaph that an NMI leaves.
const NMI: u32 = -14_i32 as u32;

/// The hash that the identity trace must come to: the newest that is committed.
pub fn committed_trace() -> Option<u64> {
    let text = include_str!("../../tests/golden/identity-trace.txt");
    let newest = text.lines().rfind(|line| !line.starts_with('#'))?;
    u64::from_str_radix(newest.split_once(' ')?.1, 16).ok()
}

/// A watchdog.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Watchdog {
    /// The window watchdog.
    Window = 1,
    /// The independent one.
    Independent = 2,
}

/// What takes long, and runs below everything else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Job {
    /// Every case of [`crate::measure`].
    Costs = 1,
    /// The identity trace.
    Trace = 2,
}

/// What has come of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// A case, and the most cycles that it took.
    Cost(&'static str, u32),
    /// The trace's hash, if it came to its end.
    Trace(Option<u64>),
    /// That was all.
    Done,
}

/// What a board does for the self-test.
pub trait Rig {
    /// Levels of PC6, PC7.
    fn encoder_lines(&mut self, a: bool, b: bool);
    /// Level of PC8, which stands for the stop's contact: high = closed.
    fn close_stop(&mut self, closed: bool);
    /// Enable, by the timer.
    fn enable(&mut self, on: bool);
    /// Level of the enable line.
    fn enable_is_high(&self) -> bool;
    /// Name of its pin.
    fn enable_pin(&self) -> &'static str;
    /// Level of PB9.
    fn ready_is_high(&self) -> bool;
    /// Level of PA6.
    fn stop_is_closed(&self) -> bool;
    /// Opens the stop; cycles until enable was seen low, none if it never was.
    fn cut(&mut self) -> Option<u32>;
    /// The core's cycle counter.
    fn cycles(&self) -> u32;
    /// Has a job done.
    fn begin(&mut self, job: Job);
    /// The next that has come of it.
    fn found(&mut self) -> Option<Found>;
    /// Bytes over USB.
    fn bulk(&self) -> &Bulk;
    /// Feeds all watchdogs but this from now on.
    fn starve(&mut self, watchdog: Option<Watchdog>);
    /// Does as the chip when its crystal fails: an NMI. The board has asked to be told if this is true.
    fn fail_crystal(&mut self) -> bool;
    /// Keeps words over resets.
    fn keep(&mut self, words: [u32; PROGRESS_WORDS]);
}

/// What a tick has read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Seen {
    /// Encoder counts, (3).
    pub counts: [i32; 3],
    /// The supply is low, or was.
    pub supply_low: bool,
    /// The two clocks contradict each other.
    pub clocks_contradict: bool,
    /// The host has taken all lines.
    pub said_all: bool,
}

/// What the last boot left: cause of the reset, kind and place of an epitaph, as in a `Report`.
#[derive(Clone, Copy, Debug)]
pub struct Left {
    /// `Report::reset_cause`.
    pub reset_cause: u8,
    /// `Report::epitaph_kind`.
    pub epitaph_kind: u8,
    /// `Report::epitaph_place`.
    pub epitaph_place: u32,
}

/// What the bytes sent over USB are, in turn: none is a word of the host's.
pub const PATTERN: &[u8; 26] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZ";

/// A line that the board sends by the thousand, as long as a packet.
pub const FILLER: &[u8; 64] = b"~0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWX~\r\n";

/// Bytes that go over USB for their own sake.
#[derive(Debug, Default)]
pub struct Bulk {
    /// Bytes that are still to come.
    down: AtomicU32,
    /// One of them was not of the pattern.
    wrong: AtomicBool,
    /// Bytes that are still to go.
    up: AtomicU32,
}

impl Bulk {
    /// None.
    pub const fn new() -> Self {
        Self {
            down: AtomicU32::new(0),
            wrong: AtomicBool::new(false),
            up: AtomicU32::new(0),
        }
    }

    /// Takes what has come, if it is for this.
    pub fn take(&self, bytes: &[u8]) -> bool {
        let left = self.down.load(Ordering::Relaxed);
        let from = BULK - left;
        let expected = PATTERN.iter().cycle().skip(from as usize % PATTERN.len());
        if left > 0 {
            let good = bytes.iter().zip(expected).all(|(is, must)| is == must);
            self.wrong.fetch_or(!good, Ordering::Relaxed);
            let left = left.saturating_sub(bytes.len() as u32);
            self.down.store(left, Ordering::Relaxed);
        }
        left > 0
    }

    /// Offers what is to go, as long as `write` takes any.
    pub fn give(&self, mut write: impl FnMut(&[u8]) -> usize) {
        loop {
            let left = self.up.load(Ordering::Relaxed) as usize;
            // All of it is whole lines.
            let from = (FILLER.len() - left % FILLER.len()) % FILLER.len();
            let taken = match FILLER.get(from..) {
                Some(rest) if left > 0 => write(rest),
                _ => 0,
            };
            if taken == 0 {
                return;
            }
            self.up.store((left - taken) as u32, Ordering::Relaxed);
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Step {
    Waiting,
    Reset,
    Clocks,
    Stop,
    Ready,
    Cut,
    Forward,
    Backward,
    Costs,
    Rows,
    Trace,
    Down,
    Up,
    Window,
    Independent,
    Crystal,
    End,
}

/// In their order; the first is where the last leads.
const STEPS: [Step; 17] = [
    Step::Waiting,
    Step::Reset,
    Step::Clocks,
    Step::Stop,
    Step::Ready,
    Step::Cut,
    Step::Forward,
    Step::Backward,
    Step::Costs,
    Step::Rows,
    Step::Trace,
    Step::Down,
    Step::Up,
    Step::Window,
    Step::Independent,
    Step::Crystal,
    Step::End,
];

impl Step {
    fn next(self) -> Step {
        let after = STEPS
            .iter()
            .cycle()
            .skip_while(|step| **step != self)
            .nth(1);
        after.copied().unwrap_or(Step::Waiting)
    }
}

/// Words that RAM keeps over a reset.
pub const PROGRESS_WORDS: usize = 3;

/// Where a self-test was when the board was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Progress {
    step: Step,
    /// Passed, failed, untimed.
    verdicts: [u8; 3],
    /// Since the watchdog was last fed.
    ticks: u16,
}

/// Nothing to go on with.
pub const NO_PROGRESS: [u32; PROGRESS_WORDS] = [0; PROGRESS_WORDS];

impl Progress {
    fn to_words(self) -> [u32; PROGRESS_WORDS] {
        let [passed, failed, untimed] = self.verdicts;
        let first = u32::from_le_bytes([self.step as u8, passed, failed, untimed]);
        let second = u32::from(self.ticks);
        [first, second, Self::check(first, second)]
    }

    /// None for noise, and for none.
    fn from_words([first, second, check]: [u32; PROGRESS_WORDS]) -> Option<Self> {
        let [step, passed, failed, untimed] = first.to_le_bytes();
        let step = STEPS.get(usize::from(step)).copied();
        step.filter(|_| check == Self::check(first, second))
            .map(|step| Progress {
                step,
                verdicts: [passed, failed, untimed],
                ticks: second as u16,
            })
    }

    fn check(first: u32, second: u32) -> u32 {
        !(first.rotate_left(9) ^ second.wrapping_mul(0x9E37_79B1))
    }
}

/// Cycles of what goes into a second of rows.
#[derive(Clone, Copy, Debug, Default)]
struct RowCosts {
    tick: u32,
    swap: u32,
    receive: u32,
    contact: u32,
    state: u32,
}

impl RowCosts {
    fn note(&mut self, name: &str, cycles: u32) {
        let most = match name {
            "tick_rows24_cones_cartesian" => &mut self.tick,
            "tick_rows24_cones_with_swap_cartesian" => &mut self.swap,
            "rows24_cones_receive_and_unpack" => &mut self.receive,
            "contact_receive_and_validate" => &mut self.contact,
            "state_encode" => &mut self.state,
            _ => return,
        };
        *most = cycles;
    }

    /// Frames of rows and their contacts that a second has room for, beside a thousand ticks and their states.
    fn a_second(&self) -> u32 {
        let left = TICK_CYCLES.saturating_sub(self.tick.saturating_add(self.state));
        let each = self.receive + self.contact + self.swap.saturating_sub(self.tick);
        (left * (1000 / 8) / (each / 8).max(1)).min(1000)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Pass,
    Fail,
    /// The cycle counter stands.
    Untimed,
}

impl From<bool> for Verdict {
    fn from(good: bool) -> Self {
        if good { Verdict::Pass } else { Verdict::Fail }
    }
}

/// A run of all checks.
#[derive(Debug)]
pub struct SelfTest {
    left: Left,
    /// Where it was before the last reset.
    was: Option<Progress>,
    step: Step,
    /// Ticks of this step.
    ticks: u16,
    /// Ticks in a row in which the host had taken all.
    quiet: u16,
    /// Tick of this step in which bytes began to go.
    begun: u16,
    counts: [i32; 3],
    last_cycles: u32,
    /// Least and most cycles of a tick.
    cycles: [u32; 2],
    rows: RowCosts,
    supply_low: bool,
    contradict: bool,
    /// Passed, failed, untimed.
    verdicts: [u8; 3],
}

impl SelfTest {
    /// One that nobody has started. `kept`: what the boot before has kept, see [`Rig::keep`].
    pub fn new(left: Left, kept: [u32; PROGRESS_WORDS]) -> Self {
        SelfTest {
            left,
            was: Progress::from_words(kept),
            step: Step::Waiting,
            ticks: 0,
            quiet: 0,
            begun: 0,
            counts: [0; 3],
            last_cycles: 0,
            cycles: [u32::MAX, 0],
            rows: RowCosts::default(),
            supply_low: false,
            contradict: false,
            verdicts: [0; 3],
        }
    }

    /// Begins all over.
    pub fn start(&mut self) {
        *self = SelfTest {
            step: Step::Reset,
            ..SelfTest::new(self.left, NO_PROGRESS)
        };
    }

    /// Goes on where a reset has interrupted it; not if none has.
    pub fn go_on(&mut self) {
        if let Some(was) = &self.was
            && self.step == Step::Waiting
        {
            self.step = was.step;
            self.verdicts = was.verdicts;
        }
    }

    /// Does a tick's part; the lines that it has come to.
    pub fn tick(&mut self, rig: &mut impl Rig, seen: &Seen) -> Lines {
        self.supply_low |= seen.supply_low;
        self.contradict |= seen.clocks_contradict;
        self.ticks = self.ticks.saturating_add(1);
        self.quiet = if seen.said_all {
            self.quiet.saturating_add(1)
        } else {
            0
        };
        let mut lines = Lines::new();
        let done = match self.step {
            Step::Waiting => return lines,
            Step::Reset => self.reset(&mut lines),
            Step::Clocks => self.clocks(rig, &mut lines),
            Step::Stop => self.stop_line(rig, &mut lines),
            Step::Ready => self.ready_line(rig, &mut lines),
            Step::Cut => self.cut(rig, &mut lines),
            Step::Forward | Step::Backward => self.encoders(rig, seen, &mut lines),
            Step::Costs => self.costs(rig, &mut lines),
            Step::Rows => self.rows_a_second(&mut lines),
            Step::Trace => self.trace(rig, &mut lines),
            Step::Down | Step::Up => self.usb(rig, &mut lines),
            Step::Window | Step::Independent => self.watchdog(rig, &mut lines),
            Step::Crystal => self.crystal(rig, &mut lines),
            Step::End => {
                let [passed, failed, untimed] = self.verdicts;
                add(
                    &mut lines,
                    format_args!("end {passed} passed {failed} failed {untimed} untimed"),
                );
                true
            }
        };
        if done {
            self.step = self.step.next();
            (self.ticks, self.quiet) = (0, 0);
        }
        lines
    }

    fn reset(&mut self, lines: &mut Lines) -> bool {
        let Left {
            reset_cause,
            epitaph_kind,
            ..
        } = self.left;
        let text = format_args!("cause {reset_cause}, epitaph {epitaph_kind}");
        self.line(lines, "reset", epitaph_kind == 0, text);
        true
    }

    /// One more tick's cycles, until there are enough.
    fn clocks(&mut self, rig: &impl Rig, lines: &mut Lines) -> bool {
        let now = rig.cycles();
        let took = now.wrapping_sub(self.last_cycles);
        self.last_cycles = now;
        // The first has none before it.
        if self.ticks > 1 {
            let [least, most] = self.cycles;
            self.cycles = [least.min(took), most.max(took)];
        }
        if self.ticks <= CLOCK_TICKS {
            return false;
        }
        let [least, most] = self.cycles;
        let good = least.abs_diff(TICK_CYCLES) <= JITTER_CYCLES
            && most.abs_diff(TICK_CYCLES) <= JITTER_CYCLES;
        let text = format_args!("{least} to {most} cycles a tick, {TICK_CYCLES} are right");
        self.line(lines, "clocks", good, text);
        let text = format_args!("SysTick against the tick timer");
        self.line(lines, "time_base", !self.contradict, text);
        let text = format_args!("above the detector's threshold");
        self.line(lines, "supply", !self.supply_low, text);
        true
    }

    /// The cycle counter stands, as it does under an emulator. `clocks` has failed for it.
    fn is_untimed(&self) -> bool {
        self.cycles == [0, 0]
    }

    fn stop_line(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        rig.close_stop(false);
        let opened = !rig.stop_is_closed();
        rig.close_stop(true);
        let good = opened && rig.stop_is_closed();
        self.line(
            lines,
            "stop_line",
            good,
            format_args!("PC8 to PA6, both ways"),
        );
        true
    }

    fn ready_line(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        rig.enable(false);
        let low = !rig.enable_is_high() && !rig.ready_is_high();
        rig.enable(true);
        let high = rig.enable_is_high() && rig.ready_is_high();
        rig.enable(false);
        let text = format_args!("{} to PB9, both ways", rig.enable_pin());
        self.line(lines, "ready_line", low && high, text);
        true
    }

    fn cut(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        rig.enable(true);
        let was = rig.enable_is_high();
        let cut = rig.cut();
        rig.enable(false);
        rig.close_stop(true);
        match cut {
            Some(_) if was && self.is_untimed() => {
                let text = format_args!("enable is low after the stop opened");
                self.line(lines, "stop_cuts", Verdict::Untimed, text);
            }
            Some(cycles) => {
                // At 168 cycles a microsecond.
                let ns = cycles.saturating_mul(1000) / 168;
                let text =
                    format_args!("enable low {ns} ns after the stop opened, 1000 are allowed");
                self.line(lines, "stop_cuts", was && cycles <= CUT_CYCLES, text);
            }
            None => {
                let text = format_args!("enable stayed high with the stop open");
                self.line(lines, "stop_cuts", false, text);
            }
        }
        true
    }

    /// Edges in one tick, what they came to in the next.
    fn encoders(&mut self, rig: &mut impl Rig, seen: &Seen, lines: &mut Lines) -> bool {
        let forward = self.step == Step::Forward;
        if self.ticks == 1 {
            self.counts = seen.counts;
            for edge in 1..=EDGES {
                // A leads B forwards.
                let phase = if forward { edge } else { -edge }.rem_euclid(4);
                rig.encoder_lines(phase == 1 || phase == 2, phase == 2 || phase == 3);
            }
            return false;
        }
        let expected = if forward { EDGES } else { -EDGES };
        let names = if forward {
            [
                "encoder_1_forward",
                "encoder_2_forward",
                "encoder_3_forward",
            ]
        } else {
            [
                "encoder_1_backward",
                "encoder_2_backward",
                "encoder_3_backward",
            ]
        };
        let counts = seen.counts.iter().zip(self.counts);
        let counts = counts.map(|(now, before)| now.wrapping_sub(before));
        for (name, count) in names.into_iter().zip(counts) {
            let text = format_args!("{count} of {expected} counts");
            self.line(lines, name, count == expected, text);
        }
        true
    }

    /// A sign of life, every second.
    fn busy(&self, name: &str, lines: &mut Lines) {
        if self.ticks.is_multiple_of(1000) {
            add(lines, format_args!("busy {name}"));
        }
    }

    /// What every case costs, line by line as they come.
    fn costs(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        if self.ticks == 1 {
            rig.begin(Job::Costs);
        }
        self.busy("costs", lines);
        match rig.found() {
            Some(Found::Cost(name, cycles)) => {
                self.rows.note(name, cycles);
                let text = format_args!("{cycles} cycles");
                let verdict = match self.is_untimed() {
                    true => Verdict::Untimed,
                    false => {
                        (cycles > 0 && (cycles <= MOST_CYCLES || !name.starts_with("tick_"))).into()
                    }
                };
                self.line(lines, name, verdict, text);
                false
            }
            found => found == Some(Found::Done),
        }
    }

    fn rows_a_second(&mut self, lines: &mut Lines) -> bool {
        if self.is_untimed() {
            let text = format_args!("frames of 24 rows");
            self.line(lines, "rows_a_second", Verdict::Untimed, text);
        } else {
            let most = self.rows.a_second();
            let text = format_args!(
                "{most} frames of 24 rows and their contacts, {FEWEST_ROWS} are needed"
            );
            self.line(lines, "rows_a_second", most >= FEWEST_ROWS, text);
        }
        true
    }

    fn trace(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        if self.ticks == 1 {
            rig.begin(Job::Trace);
        }
        self.busy("identity_trace", lines);
        match rig.found() {
            Some(Found::Trace(Some(hash))) => {
                let good = committed_trace() == Some(hash);
                self.line(lines, "identity_trace", good, format_args!("{hash:016x}"));
                false
            }
            Some(Found::Trace(None)) => {
                let text = format_args!("it did not come to its end");
                self.line(lines, "identity_trace", false, text);
                false
            }
            found => found == Some(Found::Done),
        }
    }

    /// Bytes one way: as many as asked for, the right ones, and how fast.
    fn usb(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        let down = self.step == Step::Down;
        let bulk = rig.bulk();
        let left = if down { &bulk.down } else { &bulk.up };
        if self.ticks == 1 {
            bulk.wrong.store(false, Ordering::Relaxed);
            left.store(BULK, Ordering::Relaxed);
            if down {
                add(lines, format_args!("send {BULK}"));
            }
            return false;
        }
        let still = left.load(Ordering::Relaxed);
        if still == BULK && self.ticks < PATIENCE {
            // Counted from the first.
            self.begun = self.ticks;
        }
        if still > 0 && self.ticks < PATIENCE {
            return false;
        }
        left.store(0, Ordering::Relaxed);
        let good = still == 0 && !bulk.wrong.load(Ordering::Relaxed);
        let came = BULK - still;
        let ms = self.ticks.saturating_sub(self.begun).max(1);
        let rate = came / u32::from(ms);
        let name = if down { "usb_down" } else { "usb_up" };
        if good && self.is_untimed() {
            let text = format_args!("{came} bytes, as they were sent");
            self.line(lines, name, Verdict::Untimed, text);
        } else {
            let text = format_args!("{came} of {BULK} bytes, {rate} kB/s, {SLOWEST} are needed");
            self.line(lines, name, good && rate >= SLOWEST, text);
        }
        true
    }

    /// A watchdog that is not fed any more; on the other side of the reset, whose it was.
    fn watchdog(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        let (name, watchdog, expected, after) = match self.step {
            // The early interrupt, one step of 0.8 ms before the bite.
            Step::Window => {
                let told = (BY_HANDLER, WARNED);
                ("window_watchdog", Watchdog::Window, told, 45..=55)
            }
            // 17 to 47 kHz.
            _ => {
                let told = (BY_WATCHDOG, 0);
                (
                    "independent_watchdog",
                    Watchdog::Independent,
                    told,
                    70..=200,
                )
            }
        };
        if let Some(was) = self.was.take() {
            let Left {
                reset_cause,
                epitaph_kind,
                ..
            } = self.left;
            let good = (reset_cause, epitaph_kind) == expected && after.contains(&was.ticks);
            let ms = was.ticks;
            let text = format_args!("cause {reset_cause}, epitaph {epitaph_kind}, after {ms} ms");
            self.line(lines, name, good, text);
            return true;
        }
        let Some(waited) = self.announced(name, lines) else {
            return false;
        };
        if waited > NO_BITE {
            rig.starve(None);
            rig.keep(NO_PROGRESS);
            let text = format_args!("not within {NO_BITE} ms");
            self.line(lines, name, false, text);
            return true;
        }
        rig.starve(Some(watchdog));
        rig.keep(self.progress(waited).to_words());
        false
    }

    /// What the chip does when the crystal fails, by software: nobody can make it fail.
    fn crystal(&mut self, rig: &mut impl Rig, lines: &mut Lines) -> bool {
        let name = "clock_security";
        if self.was.take().is_some() {
            let Left {
                reset_cause,
                epitaph_kind,
                epitaph_place,
            } = self.left;
            let good = (reset_cause, epitaph_kind, epitaph_place) == (BY_HANDLER, EXCEPTION, NMI);
            let number = epitaph_place as i32;
            let text =
                format_args!("on; an NMI: cause {reset_cause}, epitaph {epitaph_kind} at {number}");
            self.line(lines, name, good, text);
            return true;
        }
        if self.announced(name, lines).is_none() {
            return false;
        }
        rig.keep(self.progress(0).to_words());
        let asked = rig.fail_crystal();
        // It has come back from it, or nobody has asked.
        rig.keep(NO_PROGRESS);
        let text = format_args!("on: {asked}; no reset after an NMI");
        self.line(lines, name, false, text);
        true
    }

    /// Says that a reset comes; once that has gone through the cable, ticks since then.
    fn announced(&mut self, name: &str, lines: &mut Lines) -> Option<u16> {
        if self.ticks == 1 {
            add(lines, format_args!("next {name}"));
            self.quiet = 0;
        }
        self.quiet.checked_sub(QUIET)
    }

    fn progress(&self, ticks: u16) -> Progress {
        Progress {
            step: self.step,
            verdicts: self.verdicts,
            ticks,
        }
    }

    fn line(
        &mut self,
        lines: &mut Lines,
        name: &str,
        verdict: impl Into<Verdict>,
        figure: Arguments<'_>,
    ) {
        let [passed, failed, untimed] = &mut self.verdicts;
        let (count, word) = match verdict.into() {
            Verdict::Pass => (passed, "pass"),
            Verdict::Fail => (failed, "FAIL"),
            Verdict::Untimed => (untimed, "untimed"),
        };
        *count = count.saturating_add(1);
        add(lines, format_args!("{word} {name} {figure}"));
    }
}

fn add(lines: &mut Lines, text: Arguments<'_>) {
    let mut line = Line::new();
    // What does not fit is cut off, and is in no line here.
    let _ = line.write_fmt(text);
    let _ = lines.push(line);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::string::{String, ToString};
    use std::vec::Vec;

    /// A board with jumpers, of which each may be missing or wrong.
    struct Bench {
        phase: i32,
        counts: [i32; 3],
        closed: bool,
        enabled: bool,
        cycles: u32,
        per_tick: u32,
        found: VecDeque<Found>,
        bulk: Bulk,
        kept: [u32; PROGRESS_WORDS],
        starved: Option<Watchdog>,
        /// Ticks since a watchdog was last fed.
        hungry: u16,
        nmi: bool,
        /// What is missing or wrong.
        missing: &'static str,
    }

    const COSTS: [(&str, u32); 5] = [
        ("tick_rows24_cones_cartesian", 90_000),
        ("tick_rows24_cones_with_swap_cartesian", 120_000),
        ("rows24_cones_receive_and_unpack", 240_000),
        ("contact_receive_and_validate", 20_000),
        ("state_encode", 6_000),
    ];

    impl Bench {
        fn new(missing: &'static str) -> Bench {
            Bench {
                phase: 0,
                counts: [5, -7, 100_000],
                closed: true,
                enabled: false,
                cycles: u32::MAX - 1000,
                per_tick: if missing == "cycles" { 0 } else { TICK_CYCLES },
                found: VecDeque::new(),
                bulk: Bulk::new(),
                kept: NO_PROGRESS,
                starved: None,
                hungry: 0,
                nmi: false,
                missing,
            }
        }

        /// Bytes go over the cable: so many in a millisecond.
        fn cable(&mut self, lines: &[String]) {
            let down = lines.iter().find_map(|line| line.strip_prefix("send "));
            if down.is_some() {
                assert_eq!(down, Some("16384"));
            }
            let left = self.bulk.down.load(Ordering::Relaxed);
            let rate = if self.missing == "usb_down" { 100 } else { 600 };
            if left > 0 {
                let from = (BULK - left) as usize;
                let bytes = PATTERN.iter().cycle().skip(from % PATTERN.len());
                let mut bytes: Vec<u8> = bytes.take(rate.min(left as usize)).copied().collect();
                if self.missing == "pattern" && from > 8_000 {
                    bytes[0] = b'?';
                }
                assert!(self.bulk.take(&bytes));
            } else {
                assert!(!self.bulk.take(b"t"), "a word of the host's");
            }
            let mut room = if self.missing == "usb_up" { 100 } else { 500 };
            self.bulk.give(|bytes| {
                assert!(FILLER.ends_with(bytes));
                let taken = bytes.len().min(room);
                room -= taken;
                taken
            });
        }

        /// What a reset leaves, if there is one now.
        fn reset(&mut self) -> Option<Left> {
            self.hungry = if self.starved.is_some() {
                self.hungry + 1
            } else {
                0
            };
            let left = |reset_cause, epitaph_kind, epitaph_place| Left {
                reset_cause,
                epitaph_kind,
                epitaph_place,
            };
            let left = match self.starved {
                _ if self.nmi => left(BY_HANDLER, EXCEPTION, NMI),
                Some(Watchdog::Window) if self.hungry == 49 => left(BY_HANDLER, WARNED, 1),
                Some(Watchdog::Independent) if self.hungry == 97 => left(BY_WATCHDOG, 0, 0),
                _ => return None,
            };
            let bites = match self.missing {
                "window_watchdog" => self.starved != Some(Watchdog::Window),
                "independent_watchdog" => self.starved != Some(Watchdog::Independent),
                _ => true,
            };
            (self.starved, self.nmi) = (None, false);
            bites.then_some(left)
        }

        /// All that is said.
        fn report(&mut self, left: Left) -> Vec<String> {
            let mut test = SelfTest::new(left, NO_PROGRESS);
            let mut lines: Vec<String> = Vec::new();
            let mut said = 0;
            for tick in 0..4000 {
                if tick == 3 {
                    test.start();
                }
                let seen = Seen {
                    counts: self.counts,
                    supply_low: self.missing == "supply" && tick == 50,
                    clocks_contradict: self.missing == "time_base" && tick == 51,
                    // One line takes a tick.
                    said_all: said == lines.len(),
                };
                said = (said + 1).min(lines.len());
                self.cycles = self.cycles.wrapping_add(self.per_tick);
                let new = test.tick(self, &seen);
                let new: Vec<String> = new.iter().map(|line| line.as_str().to_string()).collect();
                self.cable(&new);
                // An NMI comes at once: there is no rest of that tick.
                if !self.nmi {
                    lines.extend(new);
                }
                if let Some(left) = self.reset() {
                    assert_eq!(said, lines.len(), "not all has been said");
                    test = SelfTest::new(left, core::mem::replace(&mut self.kept, NO_PROGRESS));
                    for _ in 0..5 {
                        assert!(test.tick(self, &seen).is_empty(), "nobody has asked");
                    }
                    test.go_on();
                    // The host may say so more than once.
                    test.go_on();
                }
            }
            lines
        }
    }

    impl Rig for Bench {
        fn encoder_lines(&mut self, a: bool, b: bool) {
            let phase = match (a, b) {
                (false, false) => 0,
                (true, false) => 1,
                (true, true) => 2,
                (false, true) => 3,
            };
            let step = (phase - self.phase + 1).rem_euclid(4) - 1;
            assert!(step.abs() == 1, "one line at a time");
            self.phase = phase;
            for (joint, count) in self.counts.iter_mut().enumerate() {
                let swapped = self.missing == "encoder_2" && joint == 1;
                *count += if swapped { -step } else { step };
            }
        }
        fn close_stop(&mut self, closed: bool) {
            self.closed = closed || self.missing == "stop_line";
        }
        fn enable(&mut self, on: bool) {
            self.enabled = on && self.closed;
        }
        fn enable_pin(&self) -> &'static str {
            "PA8"
        }
        fn enable_is_high(&self) -> bool {
            self.enabled
        }
        fn ready_is_high(&self) -> bool {
            self.enabled && self.missing != "ready_line"
        }
        fn stop_is_closed(&self) -> bool {
            self.closed
        }
        fn cut(&mut self) -> Option<u32> {
            self.close_stop(false);
            self.enabled &= self.closed;
            match self.missing {
                "stop_cuts" => Some(169),
                _ => (!self.enabled).then_some(20),
            }
        }
        fn cycles(&self) -> u32 {
            self.cycles
        }
        fn begin(&mut self, job: Job) {
            match job {
                Job::Costs => {
                    let slow = |name: &str| self.missing == "slow" && name.starts_with("tick");
                    self.found = COSTS
                        .into_iter()
                        .map(|(name, cost)| {
                            Found::Cost(name, if slow(name) { 2 * cost } else { cost })
                        })
                        .collect();
                }
                Job::Trace => {
                    let hash = committed_trace().map(|hash| match self.missing {
                        "identity_trace" => hash ^ 1,
                        _ => hash,
                    });
                    self.found.push_back(Found::Trace(hash));
                }
            }
            self.found.push_back(Found::Done);
        }
        fn found(&mut self) -> Option<Found> {
            self.found.pop_front()
        }
        fn bulk(&self) -> &Bulk {
            &self.bulk
        }
        fn starve(&mut self, watchdog: Option<Watchdog>) {
            self.starved = watchdog;
        }
        fn fail_crystal(&mut self) -> bool {
            self.nmi = self.missing != "clock_security";
            self.nmi
        }
        fn keep(&mut self, words: [u32; PROGRESS_WORDS]) {
            if !self.nmi {
                self.kept = words;
            }
        }
    }

    const POWER_UP: Left = Left {
        reset_cause: 1,
        epitaph_kind: 0,
        epitaph_place: 0,
    };

    fn named<'a>(lines: &'a [String], verdict: &str) -> Vec<&'a str> {
        let of = |line: &'a String| line.split_once(' ').filter(|(word, _)| *word == verdict);
        let rest = lines.iter().filter_map(of).map(|(_, rest)| rest);
        rest.filter_map(|rest| rest.split(' ').next()).collect()
    }

    #[test]
    fn a_good_board_passes_all_and_says_each_figure() {
        let lines = Bench::new("").report(POWER_UP);
        let trace = std::format!(
            "pass identity_trace {:016x}",
            committed_trace().expect("one")
        );
        assert_eq!(
            lines,
            [
                "pass reset cause 1, epitaph 0",
                "pass clocks 168000 to 168000 cycles a tick, 168000 are right",
                "pass time_base SysTick against the tick timer",
                "pass supply above the detector's threshold",
                "pass stop_line PC8 to PA6, both ways",
                "pass ready_line PA8 to PB9, both ways",
                "pass stop_cuts enable low 119 ns after the stop opened, 1000 are allowed",
                "pass encoder_1_forward 400 of 400 counts",
                "pass encoder_2_forward 400 of 400 counts",
                "pass encoder_3_forward 400 of 400 counts",
                "pass encoder_1_backward -400 of -400 counts",
                "pass encoder_2_backward -400 of -400 counts",
                "pass encoder_3_backward -400 of -400 counts",
                "pass tick_rows24_cones_cartesian 90000 cycles",
                "pass tick_rows24_cones_with_swap_cartesian 120000 cycles",
                "pass rows24_cones_receive_and_unpack 240000 cycles",
                "pass contact_receive_and_validate 20000 cycles",
                "pass state_encode 6000 cycles",
                // 72 million cycles are left of a second, and a frame takes 290,000.
                "pass rows_a_second 248 frames of 24 rows and their contacts, 100 are needed",
                trace.as_str(),
                "send 16384",
                "pass usb_down 16384 of 16384 bytes, 564 kB/s, 200 are needed",
                "pass usb_up 16384 of 16384 bytes, 481 kB/s, 200 are needed",
                "next window_watchdog",
                "pass window_watchdog cause 5, epitaph 4, after 48 ms",
                "next independent_watchdog",
                "pass independent_watchdog cause 4, epitaph 0, after 96 ms",
                "next clock_security",
                "pass clock_security on; an NMI: cause 5, epitaph 3 at -14",
                "end 25 passed 0 failed 0 untimed",
            ]
        );
    }

    #[test]
    fn each_thing_that_is_wrong_fails_its_own_checks() {
        for (missing, names) in [
            ("stop_line", &["stop_line", "stop_cuts"][..]),
            ("stop_cuts", &["stop_cuts"]),
            ("ready_line", &["ready_line"]),
            ("encoder_2", &["encoder_2_forward", "encoder_2_backward"]),
            ("supply", &["supply"]),
            ("time_base", &["time_base"]),
            (
                "slow",
                &[
                    "tick_rows24_cones_cartesian",
                    "tick_rows24_cones_with_swap_cartesian",
                    "rows_a_second",
                ],
            ),
            ("identity_trace", &["identity_trace"]),
            ("usb_down", &["usb_down"]),
            ("pattern", &["usb_down"]),
            ("usb_up", &["usb_up"]),
            ("window_watchdog", &["window_watchdog"]),
            ("independent_watchdog", &["independent_watchdog"]),
            ("clock_security", &["clock_security"]),
        ] {
            let lines = Bench::new(missing).report(POWER_UP);
            assert_eq!(named(&lines, "FAIL"), names, "{missing}");
            let end = lines.last().expect("an end");
            let (passed, failed) = (25 - names.len(), names.len());
            assert_eq!(
                *end,
                std::format!("end {passed} passed {failed} failed 0 untimed")
            );
        }
        for per_tick in [165_000, 171_000] {
            let mut bench = Bench {
                per_tick,
                ..Bench::new("")
            };
            assert_eq!(named(&bench.report(POWER_UP), "FAIL"), ["clocks"]);
        }
        let crashed = Left {
            reset_cause: 5,
            epitaph_kind: 2,
            epitaph_place: 7,
        };
        let lines = Bench::new("").report(crashed);
        assert_eq!(named(&lines, "FAIL"), ["reset"]);
    }

    /// A counter that stands is one failure, and no figure is made of it.
    #[test]
    fn what_the_cycle_counter_does_not_time_is_said_to_be_untimed() {
        let lines = Bench::new("cycles").report(POWER_UP);
        assert_eq!(named(&lines, "FAIL"), ["clocks"]);
        let costs = COSTS.map(|(name, _)| name);
        let mut expected = std::vec!["stop_cuts"];
        expected.extend(costs);
        expected.extend(["rows_a_second", "usb_down", "usb_up"]);
        assert_eq!(named(&lines, "untimed"), expected);
        assert_eq!(
            lines.last().map(String::as_str),
            Some("end 15 passed 1 failed 9 untimed")
        );
    }

    #[test]
    fn progress_survives_and_one_flipped_bit_voids_it() {
        for step in STEPS {
            let progress = Progress {
                step,
                verdicts: [3, 200, 7],
                ticks: 48,
            };
            let words = progress.to_words();
            assert_eq!(Progress::from_words(words), Some(progress));
            for bit in 0..96 {
                let mut broken = words;
                broken[bit / 32] ^= 1 << (bit % 32);
                assert_eq!(Progress::from_words(broken), None, "{step:?}, bit {bit}");
            }
        }
        assert_eq!(Progress::from_words(NO_PROGRESS), None);
        assert_eq!(Progress::from_words([u32::MAX; 3]), None);
    }

    /// With the stop's jumper missing enable would stay on: it is off at the end of every step.
    #[test]
    fn enable_is_never_left_on() {
        for missing in ["", "stop_line", "stop_cuts", "ready_line"] {
            let mut bench = Bench::new(missing);
            bench.report(POWER_UP);
            assert!(!bench.enabled, "{missing}");
        }
    }
}
