//! What has happened in a session, in the order of time.
//!
//! Entry points: [`EventLog::step`], [`EventLog::said`].

use crate::event::{Event, Held, Loss};
use crate::step::StepReport;
use crate::thread::ThreadEnd;
use serde_json::{Value, json};

/// Most events that a session tells; of later ones there is a count.
const MOST: usize = 256;

/// An event of a session. What slips on from step to step is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Happened {
    /// When it began, since the first step \[s\].
    pub time_s: f64,
    /// When it was over, since the first step \[s\].
    pub until_s: f64,
    /// What.
    pub event: Event,
    /// Balanced step that had it last.
    step: u64,
}

/// The events so far.
#[derive(Clone, Debug)]
pub(super) struct EventLog {
    all: Vec<Happened>,
    /// How many found no room.
    left_out: u64,
    /// Steps that found a balance.
    steps: u64,
    /// Largest pressure of each thread on tissue, what that bears, and whether it has been told that it is more \[Pa\].
    pressures: Vec<(f64, f64, bool)>,
}

impl EventLog {
    /// Nothing yet; tissue bears so much of each thread \[Pa\].
    pub fn new(tear_pa: impl Iterator<Item = f64>) -> Self {
        Self {
            pressures: tear_pa.map(|tear_pa| (0.0, tear_pa, false)).collect(),
            all: Vec::with_capacity(MOST),
            left_out: 0,
            steps: 0,
        }
    }

    /// Takes note of a step at a time \[s\].
    pub fn step(&mut self, time_s: f64, report: &StepReport) {
        if !report.status.has_balance() {
            return;
        }
        self.steps += 1;
        for event in report.events() {
            self.note(time_s, event);
        }
        for (place, thread) in report.threads().iter().enumerate() {
            let Some((peak_pa, tear_pa, is_told)) = self.pressures.get_mut(place) else {
                continue;
            };
            *peak_pa = peak_pa.max(thread.pressure_pa);
            let tear_pa = *tear_pa;
            if thread.pressure_pa > tear_pa && !std::mem::replace(is_told, true) {
                let pressed = Event::Pressed {
                    thread: thread.id,
                    pressure_pa: thread.pressure_pa,
                    tear_pa,
                };
                self.note(time_s, pressed);
                tracing::warn!(
                    "thread {} presses on tissue with {:.0} kPa, which bears {:.0} kPa",
                    thread.id,
                    1e-3 * thread.pressure_pa,
                    1e-3 * tear_pa
                );
            }
        }
    }

    /// Largest pressure of each thread on tissue so far \[Pa\].
    pub fn peaks_pa(&self) -> impl Iterator<Item = f64> {
        self.pressures.iter().map(|(peak_pa, ..)| *peak_pa)
    }

    /// Takes note of an event at a time \[s\].
    pub fn note(&mut self, time_s: f64, event: Event) {
        let step = self.steps;
        if let Some(before) = self.all.iter_mut().rev().find(|one| one.goes_on(&event)) {
            let is_next = before.step + 1 >= step;
            if is_next && before.take(&event) {
                (before.until_s, before.step) = (time_s, step);
                return;
            }
        }
        if self.all.len() == MOST {
            self.left_out += 1;
            return;
        }
        self.all.push(Happened {
            time_s,
            until_s: time_s,
            event,
            step,
        });
    }

    /// All that there was room for.
    pub fn all(&self) -> &[Happened] {
        &self.all
    }

    /// Its part of the summary: the events, and how many more there were.
    pub fn said(&self) -> (Value, u64) {
        let all = self.all.iter().copied().map(Happened::to_json);
        (all.collect(), self.left_out)
    }
}

impl Happened {
    /// Whether an event is of the same end in the same grip.
    fn goes_on(&self, next: &Event) -> bool {
        let of = |event: &Event| match event {
            Event::Slipped {
                thread, end, tool, ..
            } => Some((*thread, *end, *tool)),
            _ => None,
        };
        of(next).is_some_and(|next| of(&self.event) == Some(next))
    }

    /// Adds what has slipped since; whether it was not over before.
    fn take(&mut self, next: &Event) -> bool {
        let (
            Event::Slipped {
                length_m, is_out, ..
            },
            Event::Slipped {
                length_m: more_m,
                is_out: is_out_now,
                ..
            },
        ) = (&mut self.event, next)
        else {
            return false;
        };
        let goes_on = !*is_out;
        if goes_on {
            *length_m += more_m;
            *is_out = *is_out_now;
        }
        goes_on
    }

    fn to_json(self) -> Value {
        let (time_s, until_s) = (self.time_s, self.until_s);
        match self.event {
            Event::Slipped {
                thread,
                end,
                tool,
                length_m,
                is_out,
            } => json!({
                "event": "slipped",
                "time_s": time_s,
                "until_s": until_s,
                "thread": thread,
                "end": word(end),
                "tool": tool,
                "length_m": length_m,
                "is_out": is_out,
            }),
            Event::Broke {
                thread,
                tension_n,
                lost_m,
            } => json!({
                "event": "broke",
                "time_s": time_s,
                "thread": thread,
                "tension_n": tension_n,
                "lost_m": lost_m,
            }),
            Event::Cut { thread, along_m } => json!({
                "event": "cut",
                "time_s": time_s,
                "thread": thread,
                "along_m": along_m,
            }),
            Event::Opened { thread, tension_n } => json!({
                "event": "opened",
                "time_s": time_s,
                "thread": thread,
                "tension_n": tension_n,
            }),
            Event::Pressed {
                thread,
                pressure_pa,
                tear_pa,
            } => json!({
                "event": "pressed",
                "time_s": time_s,
                "thread": thread,
                "pressure_pa": pressure_pa,
                "tear_pa": tear_pa,
            }),
            Event::Grasped { tool, points } => json!({
                "event": "grasped",
                "time_s": time_s,
                "tool": tool,
                "points": points,
            }),
            Event::Lost { tool, why } => json!({
                "event": "lost",
                "time_s": time_s,
                "tool": tool,
                "why": match why {
                    Loss::Nothing => "nothing",
                    Loss::Slipped => "slipped",
                    Loss::Tore => "tore",
                },
            }),
            Event::Missed {
                tool,
                what,
                distance_m,
                nearest_m,
            } => {
                let mut said = json!({
                    "event": "missed",
                    "time_s": time_s,
                    "tool": tool,
                    "distance_m": distance_m,
                    "nearest_m": nearest_m,
                });
                match what {
                    Held::Needle(id) => said["needle"] = id.into(),
                    Held::Thread(id, end) => {
                        said["thread"] = id.into();
                        said["end"] = word(end).into();
                    }
                }
                said
            }
        }
    }
}

/// As a sentence has it.
pub(super) fn name(what: &Held) -> String {
    match what {
        Held::Needle(id) => format!("needle {id}"),
        Held::Thread(id, ThreadEnd::Span) => format!("thread {id} by a span"),
        Held::Thread(id, end) => format!("thread {id} by its {}", word(*end)),
    }
}

/// As files write it.
fn word(end: ThreadEnd) -> &'static str {
    match end {
        ThreadEnd::Tail => "tail",
        ThreadEnd::Head => "head",
        ThreadEnd::Span => "span",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::step::Status;

    fn slip(tool: u8, is_out: bool) -> Event {
        Event::Slipped {
            thread: 3,
            end: ThreadEnd::Tail,
            tool,
            length_m: 1e-3,
            is_out,
        }
    }

    /// Of a slip that lasts there is one event; what comes after a pause, or through another grip, is another.
    #[test]
    fn what_slips_on_is_one_event() {
        let mut log = EventLog::new(std::iter::empty());
        let mut step = |time_s: f64, event: Option<Event>| {
            let mut report = StepReport::default();
            event.into_iter().for_each(|event| report.happened(event));
            log.step(time_s, &report);
            // What waits for columns is no pause.
            report.status = Status::Waiting;
            log.step(time_s, &report);
        };
        step(0.1, Some(slip(1, false)));
        step(0.2, Some(slip(1, false)));
        step(0.3, None);
        step(0.4, Some(slip(1, true)));
        step(0.5, Some(slip(1, false)));
        step(0.6, Some(slip(2, false)));
        let found: Vec<_> = log
            .all()
            .iter()
            .map(|one| (one.time_s, one.until_s))
            .collect();
        assert_eq!(found, [(0.1, 0.2), (0.4, 0.4), (0.5, 0.5), (0.6, 0.6)]);
        let (said, more) = log.said();
        assert_eq!(more, 0);
        assert_eq!(said[0]["length_m"], 2e-3);
        assert_eq!(said[0]["end"], "tail");
        assert_eq!(said[1]["is_out"], true);
        assert_eq!(said[3]["tool"], 2);
    }

    #[test]
    fn what_finds_no_room_is_counted() {
        let mut log = EventLog::new(std::iter::empty());
        let broke = Event::Broke {
            thread: 0,
            tension_n: 1.0,
            lost_m: 0.1,
        };
        for _ in 0..MOST + 2 {
            log.note(0.0, broke);
        }
        assert_eq!((log.all().len(), log.said().1), (MOST, 2));
    }

    /// What a thread presses is kept at its largest, and told once where tissue bears less.
    #[test]
    fn a_thread_that_presses_too_hard_is_told_once() {
        let mut log = EventLog::new([2e5].into_iter());
        for (time_s, pressure_pa) in [(0.1, 1e5), (0.2, 2.5e5), (0.3, 1e5), (0.4, 3e5)] {
            let mut report = StepReport::default();
            report.threads_mut(1)[0].pressure_pa = pressure_pa;
            log.step(time_s, &report);
        }
        let told: Vec<_> = log
            .all()
            .iter()
            .map(|one| (one.time_s, one.event))
            .collect();
        let pressed = Event::Pressed {
            thread: 0,
            pressure_pa: 2.5e5,
            tear_pa: 2e5,
        };
        assert_eq!(told, [(0.2, pressed)]);
        assert_eq!(log.peaks_pa().collect::<Vec<_>>(), [3e5]);
    }
}
