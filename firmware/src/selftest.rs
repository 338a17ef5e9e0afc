//! What a bare board with a few jumpers can find out about itself, without amplifiers: one line a check, with its figure.
//!
//! Entry point: [`SelfTest::tick`], once a tick. It asks a board through [`Rig`], so that the order of checks and every verdict are tested on
//! the build machine. Jumpers: PC6 to A and PC7 to B of all three encoders, PC8 to PA6, PC9 to PB9, and nothing else on any of them.

use core::fmt::Write;
use heapless::String;

/// A line of the report.
pub type Line = String<96>;

/// Edges that a check of encoders makes: four counts in a hundred periods.
const EDGES: i32 = 400;
/// Ticks over which the clocks are looked at.
const CLOCK_TICKS: u16 = 500;
/// Cycles of a tick, and how far a single one may be off: an interrupt's entry, twice over, and what locks hold.
const TICK_CYCLES: u32 = 168_000;
const JITTER_CYCLES: u32 = 2_000;
/// Longest time from the stop line's opening until enable is low: a microsecond, which is the pins' and the timer's own many times.
const CUT_CYCLES: u32 = 168;

/// What a board does for the self-test.
pub trait Rig {
    /// Levels of PC6, PC7.
    fn encoder_lines(&mut self, a: bool, b: bool);
    /// Level of PC8, which stands for the stop's contact: high = closed.
    fn close_stop(&mut self, closed: bool);
    /// Enable, by the timer.
    fn enable(&mut self, on: bool);
    /// Level of PC9.
    fn enable_is_high(&self) -> bool;
    /// Level of PB9.
    fn ready_is_high(&self) -> bool;
    /// Level of PA6.
    fn stop_is_closed(&self) -> bool;
    /// Opens the stop; cycles until enable was seen low, none if it never was.
    fn cut(&mut self) -> Option<u32>;
    /// The core's cycle counter.
    fn cycles(&self) -> u32;
    /// Most cycles that a control tick with a new contact takes.
    fn tick_cost(&mut self) -> u32;
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
}

/// What the last boot left: cause of the reset, kind of an epitaph, as in a `Report`.
#[derive(Clone, Copy, Debug)]
pub struct Left {
    /// `Report::reset_cause`.
    pub reset_cause: u8,
    /// `Report::epitaph_kind`.
    pub epitaph_kind: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Waiting,
    Reset,
    Clocks,
    Stop,
    Ready,
    Cut,
    Forward,
    Backward,
    Cost,
    End,
}

/// A run of all checks.
#[derive(Debug)]
pub struct SelfTest {
    left: Left,
    step: Step,
    /// Ticks of this step.
    ticks: u16,
    counts: [i32; 3],
    last_cycles: u32,
    /// Least and most cycles of a tick.
    cycles: [u32; 2],
    supply_low: bool,
    contradict: bool,
    /// Passed, failed.
    verdicts: [u8; 2],
}

impl SelfTest {
    /// One that nobody has started.
    pub fn new(left: Left) -> Self {
        SelfTest {
            left,
            step: Step::Waiting,
            ticks: 0,
            counts: [0; 3],
            last_cycles: 0,
            cycles: [u32::MAX, 0],
            supply_low: false,
            contradict: false,
            verdicts: [0; 2],
        }
    }

    /// Begins all over.
    pub fn start(&mut self) {
        *self = SelfTest {
            step: Step::Reset,
            ..SelfTest::new(self.left)
        };
    }

    /// Does a tick's part; up to three lines, in order.
    pub fn tick(&mut self, rig: &mut impl Rig, seen: &Seen) -> [Option<Line>; 3] {
        self.supply_low |= seen.supply_low;
        self.contradict |= seen.clocks_contradict;
        self.ticks = self.ticks.saturating_add(1);
        let lines = match self.step {
            Step::Waiting => return [const { None }; 3],
            Step::Reset => {
                let Left {
                    reset_cause,
                    epitaph_kind,
                } = self.left;
                let text = format_args!("cause {reset_cause}, epitaph {epitaph_kind}");
                [
                    Some(self.line("reset", epitaph_kind == 0, text)),
                    None,
                    None,
                ]
            }
            Step::Clocks => {
                if !self.clocks(rig) {
                    return [const { None }; 3];
                }
                let [least, most] = self.cycles;
                let good = least.abs_diff(TICK_CYCLES) <= JITTER_CYCLES
                    && most.abs_diff(TICK_CYCLES) <= JITTER_CYCLES;
                let clocks = self.line(
                    "clocks",
                    good,
                    format_args!("{least} to {most} cycles a tick, {TICK_CYCLES} are right"),
                );
                let apart = self.line(
                    "time_base",
                    !self.contradict,
                    format_args!("SysTick against the tick timer"),
                );
                let supply = self.line(
                    "supply",
                    !self.supply_low,
                    format_args!("above the detector's threshold"),
                );
                [Some(clocks), Some(apart), Some(supply)]
            }
            Step::Stop => {
                rig.close_stop(false);
                let opened = !rig.stop_is_closed();
                rig.close_stop(true);
                let good = opened && rig.stop_is_closed();
                [
                    Some(self.line("stop_line", good, format_args!("PC8 to PA6, both ways"))),
                    None,
                    None,
                ]
            }
            Step::Ready => {
                rig.enable(false);
                let low = !rig.enable_is_high() && !rig.ready_is_high();
                rig.enable(true);
                let high = rig.enable_is_high() && rig.ready_is_high();
                rig.enable(false);
                [
                    Some(self.line(
                        "ready_line",
                        low && high,
                        format_args!("PC9 to PB9, both ways"),
                    )),
                    None,
                    None,
                ]
            }
            Step::Cut => {
                rig.enable(true);
                let was = rig.enable_is_high();
                let cut = rig.cut();
                rig.enable(false);
                rig.close_stop(true);
                let good = was && cut.is_some_and(|cycles| cycles <= CUT_CYCLES);
                let line = match cut {
                    // At 168 cycles a microsecond.
                    Some(cycles) => {
                        let ns = cycles.saturating_mul(1000) / 168;
                        let text = format_args!(
                            "enable low {ns} ns after the stop opened, 1000 are allowed"
                        );
                        self.line("stop_cuts", good, text)
                    }
                    None => self.line(
                        "stop_cuts",
                        good,
                        format_args!("enable stayed high with the stop open"),
                    ),
                };
                [Some(line), None, None]
            }
            Step::Forward | Step::Backward => match self.encoders(rig, seen) {
                Some(lines) => lines,
                None => return [const { None }; 3],
            },
            Step::Cost => {
                let cost = rig.tick_cost();
                let good = cost > 0 && cost < TICK_CYCLES / 2;
                let text =
                    format_args!("{cost} cycles for a tick with a new contact, of {TICK_CYCLES}");
                [Some(self.line("tick_cost", good, text)), None, None]
            }
            Step::End => {
                let [passed, failed] = self.verdicts;
                let mut line = Line::new();
                let _ = write!(line, "end {passed} passed {failed} failed");
                [Some(line), None, None]
            }
        };
        self.step = match self.step {
            Step::Reset => Step::Clocks,
            Step::Clocks => Step::Stop,
            Step::Stop => Step::Ready,
            Step::Ready => Step::Cut,
            Step::Cut => Step::Forward,
            Step::Forward => Step::Backward,
            Step::Backward => Step::Cost,
            Step::Cost => Step::End,
            Step::Waiting | Step::End => Step::Waiting,
        };
        self.ticks = 0;
        lines
    }

    /// One more tick's cycles; true once there are enough.
    fn clocks(&mut self, rig: &impl Rig) -> bool {
        let now = rig.cycles();
        let took = now.wrapping_sub(self.last_cycles);
        self.last_cycles = now;
        // The first has none before it.
        if self.ticks > 1 {
            let [least, most] = self.cycles;
            self.cycles = [least.min(took), most.max(took)];
        }
        self.ticks > CLOCK_TICKS
    }

    /// Edges in one tick, what they came to in the next.
    fn encoders(&mut self, rig: &mut impl Rig, seen: &Seen) -> Option<[Option<Line>; 3]> {
        let forward = self.step == Step::Forward;
        if self.ticks == 1 {
            self.counts = seen.counts;
            for edge in 1..=EDGES {
                // A leads B forwards.
                let phase = if forward { edge } else { -edge }.rem_euclid(4);
                rig.encoder_lines(phase == 1 || phase == 2, phase == 2 || phase == 3);
            }
            return None;
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
        let before = self.counts;
        let counts: [i32; 3] =
            core::array::from_fn(|joint| seen.counts[joint].wrapping_sub(before[joint]));
        let lines = [0, 1, 2].map(|joint| {
            let count = counts[joint];
            Some(self.line(
                names[joint],
                count == expected,
                format_args!("{count} of {expected} counts"),
            ))
        });
        Some(lines)
    }

    fn line(&mut self, name: &str, good: bool, figure: core::fmt::Arguments<'_>) -> Line {
        let [passed, failed] = &mut self.verdicts;
        let verdict = if good {
            *passed += 1;
            "pass"
        } else {
            *failed += 1;
            "FAIL"
        };
        let mut line = Line::new();
        // What does not fit is cut off, and is in no line here.
        let _ = write!(line, "{verdict} {name} {figure}");
        line
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
        cost: u32,
        /// Jumpers, by what they are for.
        missing: &'static str,
    }

    impl Bench {
        fn new(missing: &'static str) -> Bench {
            Bench {
                phase: 0,
                counts: [5, -7, 100_000],
                closed: true,
                enabled: false,
                cycles: u32::MAX - 1000,
                per_tick: TICK_CYCLES,
                cost: 9_000,
                missing,
            }
        }

        fn report(&mut self, left: Left) -> Vec<String> {
            let mut test = SelfTest::new(left);
            let mut lines = Vec::new();
            for tick in 0..700 {
                if tick == 3 {
                    test.start();
                }
                let seen = Seen {
                    counts: self.counts,
                    supply_low: self.missing == "supply" && tick == 50,
                    clocks_contradict: self.missing == "time_base" && tick == 51,
                };
                self.cycles = self.cycles.wrapping_add(self.per_tick);
                lines.extend(
                    test.tick(self, &seen)
                        .into_iter()
                        .flatten()
                        .map(|line| line.as_str().to_string()),
                );
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
        fn tick_cost(&mut self) -> u32 {
            self.cost
        }
    }

    const POWER_UP: Left = Left {
        reset_cause: 1,
        epitaph_kind: 0,
    };

    fn failed(lines: &[String]) -> Vec<&str> {
        let names = lines.iter().filter_map(|line| line.strip_prefix("FAIL "));
        names.filter_map(|rest| rest.split(' ').next()).collect()
    }

    #[test]
    fn a_good_board_passes_all_and_says_each_figure() {
        let lines = Bench::new("").report(POWER_UP);
        assert_eq!(
            lines,
            [
                "pass reset cause 1, epitaph 0",
                "pass clocks 168000 to 168000 cycles a tick, 168000 are right",
                "pass time_base SysTick against the tick timer",
                "pass supply above the detector's threshold",
                "pass stop_line PC8 to PA6, both ways",
                "pass ready_line PC9 to PB9, both ways",
                "pass stop_cuts enable low 119 ns after the stop opened, 1000 are allowed",
                "pass encoder_1_forward 400 of 400 counts",
                "pass encoder_2_forward 400 of 400 counts",
                "pass encoder_3_forward 400 of 400 counts",
                "pass encoder_1_backward -400 of -400 counts",
                "pass encoder_2_backward -400 of -400 counts",
                "pass encoder_3_backward -400 of -400 counts",
                "pass tick_cost 9000 cycles for a tick with a new contact, of 168000",
                "end 14 passed 0 failed",
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
        ] {
            let lines = Bench::new(missing).report(POWER_UP);
            assert_eq!(failed(&lines), names, "{missing}");
            let end = lines.last().expect("an end");
            assert_eq!(
                *end,
                std::format!("end {} passed {} failed", 14 - names.len(), names.len())
            );
        }
        for (per_tick, cost, name) in [
            (165_000, 9_000, "clocks"),
            (0, 9_000, "clocks"),
            (168_000, 90_000, "tick_cost"),
            (168_000, 0, "tick_cost"),
        ] {
            let mut bench = Bench {
                per_tick,
                cost,
                ..Bench::new("")
            };
            assert_eq!(failed(&bench.report(POWER_UP)), [name]);
        }
        let crashed = Left {
            reset_cause: 5,
            epitaph_kind: 2,
        };
        assert_eq!(failed(&Bench::new("").report(crashed)), ["reset"]);
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
