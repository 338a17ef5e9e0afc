//! What may come in before a tick: drawn from a number, cut down when it shows a defect, and kept as text.
//!
//! Entry points: [`Dice`], [`shrink`], [`to_text`], [`from_text`].

#![allow(clippy::unwrap_used, reason = "tests")]

use std::fmt::Write;
use std::str::FromStr;
use sutura_shared::wire::message::{Command, Contact, Fixture};
use sutura_testkit::Random;

/// What happens before one tick.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    pub counts: Counts,
    /// Age \[us\] and contact.
    pub contact: Option<(u64, Contact)>,
    pub command: Option<Command>,
    /// Put up in the place of the one before.
    pub fixture: Option<Fixture>,
    /// Emergency stop, board fault, overrun.
    pub flags: [bool; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Counts {
    /// As a hand would move them, times 6.
    Moved([i8; 3]),
    /// As a broken cable would.
    Anything([i32; 3]),
}

/// Stands still and hears nothing.
pub const SILENCE: Event = Event {
    counts: Counts::Moved([0; 3]),
    contact: None,
    command: None,
    fixture: None,
    flags: [false; 3],
};

/// How often things happen, parts of the ticks.
struct Course {
    cable_breaks: f64,
    contact: f64,
    flags: [f64; 3],
}

impl Course {
    const ROUGH: Course = Course {
        cable_breaks: 0.005,
        contact: 0.2,
        flags: [0.005, 0.005, 0.1],
    };
    /// A contact is used for as long as it may be, and nothing puts an end to it.
    const CALM: Course = Course {
        cable_breaks: 0.0,
        contact: 0.05,
        flags: [0.0; 3],
    };
}

/// Numbers from a seed.
pub struct Dice(Random);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    pub fn bits(&mut self) -> u64 {
        self.0.bits()
    }

    /// 0 to `end`, without it.
    pub fn below(&mut self, end: u64) -> u64 {
        self.0.below(end as usize) as u64
    }

    /// 0 to 1, without it.
    fn part(&mut self) -> f64 {
        self.0.unit()
    }

    pub fn chance(&mut self, part: f64) -> bool {
        self.part() < part
    }

    fn within(&mut self, limit: f32) -> f32 {
        ((2.0 * self.part() - 1.0) * f64::from(limit)) as f32
    }

    /// Up to `limit` in magnitude: any size, zeros of both signs and subnormals often.
    fn number(&mut self, limit: f32) -> f32 {
        if self.chance(0.5) {
            return self.within(limit);
        }
        let bits = self.bits() as u32;
        let (sign, mantissa) = (bits & 1 << 31, bits & ((1 << 23) - 1));
        let exponent = self.below(255) as u32;
        let any = match self.below(3) {
            0 => f32::from_bits(sign),
            1 => f32::from_bits(sign | mantissa),
            _ => f32::from_bits(sign | exponent << 23 | mantissa),
        };
        sutura_shared::math::clamp(any, -limit, limit)
    }

    fn unit(&mut self) -> [f32; 3] {
        loop {
            let v: [f64; 3] = std::array::from_fn(|_| 2.0 * self.part() - 1.0);
            let square = v.iter().map(|x| x * x).sum::<f64>();
            if square > 0.01 {
                return v.map(|x| (x / square.sqrt()) as f32);
            }
        }
    }

    fn contact(&mut self) -> Contact {
        let place = if self.chance(0.5) {
            std::array::from_fn(|_| self.within(0.1))
        } else {
            std::array::from_fn(|_| self.number(10.0))
        };
        let mut either = |some: f32, many: f32| {
            let limit = if self.chance(0.5) { some } else { many };
            self.number(limit)
        };
        let wrench = std::array::from_fn(|_| either(20.0, 1e4));
        let tangent = std::array::from_fn(|_| either(5000.0, 1e7));
        let gap_m = match self.below(4) {
            0 => 0.0,
            1 => -0.0,
            2 => self.within(0.01).abs(),
            _ => self.number(10.0).abs(),
        };
        Contact {
            tool: self.below(2) as u8,
            position_m: place,
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench,
            tangent,
            gap_m,
            normal: self.unit(),
            relaxation_per_s: self.number(1000.0).abs(),
            horizon_us: if self.chance(0.5) {
                self.below(200_000) as u32
            } else {
                self.bits() as u32
            },
        }
    }

    fn event(&mut self, course: &Course) -> Event {
        let counts = if self.chance(course.cable_breaks) {
            Counts::Anything(std::array::from_fn(|_| self.bits() as i32))
        } else {
            Counts::Moved(std::array::from_fn(|_| self.bits() as i8))
        };
        let contact = self.chance(course.contact).then(|| {
            let age_us = match self.below(3) {
                0 => self.below(20_000),
                1 => self.below(400_000),
                _ => self.bits(),
            };
            (age_us, self.contact())
        });
        let command = self.chance(0.3).then(|| match self.below(11) {
            0..5 => Command::Arm,
            5 => Command::Disarm,
            _ => Command::ClearFault,
        });
        Event {
            counts,
            contact,
            command,
            fixture: None,
            flags: course.flags.map(|part| self.chance(part)),
        }
    }

    /// Out of reach, where it is only there, or where the hand is.
    fn fixture(&mut self) -> Fixture {
        let normal = self.unit();
        let stiffness_n_per_m = self.number(20_000.0).abs();
        let damping_n_s_per_m = self.number(50.0).abs();
        match self.below(4) {
            0 => Fixture::None,
            1 => Fixture::Coupling {
                anchor_m: std::array::from_fn(|_| self.within(0.05)),
                stiffness_n_per_m,
                damping_n_s_per_m,
            },
            kind => Fixture::Wall {
                point_m: match kind {
                    2 => std::array::from_fn(|_| self.within(0.05)),
                    _ => normal.map(|n| -2.0 * n),
                },
                normal,
                stiffness_n_per_m,
                damping_n_s_per_m,
            },
        }
    }

    /// So many of them, of one course; half of the courses with up to three fixtures on the way.
    pub fn events(&mut self, count: usize) -> Vec<Event> {
        let course = if self.chance(0.5) {
            Course::ROUGH
        } else {
            Course {
                contact: [0.02, 0.05, 0.2][self.below(3) as usize],
                ..Course::CALM
            }
        };
        let mut events: Vec<_> = (0..count).map(|_| self.event(&course)).collect();
        let fixtures = if self.chance(0.5) { self.below(4) } else { 0 };
        for _ in 0..fixtures {
            let at = self.below(count as u64) as usize;
            events[at].fixture = Some(self.fixture());
        }
        events
    }
}

/// The shortest and plainest events found that still fail: cut off, taken out, made still.
pub fn shrink(events: &[Event], fails: impl Fn(&[Event]) -> bool) -> Vec<Event> {
    let mut events = events.to_vec();
    let mut changed = true;
    while changed {
        changed = false;
        let mut chunk = events.len().max(1);
        while chunk > 0 {
            let mut from = 0;
            while from < events.len() {
                let to = (from + chunk).min(events.len());
                let less = [&events[..from], &events[to..]].concat();
                if fails(&less) {
                    (events, changed) = (less, true);
                } else {
                    from = to;
                }
            }
            chunk /= 2;
        }
        for index in 0..events.len() {
            let plain: [fn(&mut Event); 5] = [
                |event| event.contact = None,
                |event| event.command = None,
                |event| event.fixture = None,
                |event| event.flags = [false; 3],
                |event| event.counts = SILENCE.counts,
            ];
            for make_plain in plain {
                let mut plainer = events.clone();
                make_plain(&mut plainer[index]);
                if plainer != events && fails(&plainer) {
                    (events, changed) = (plainer, true);
                }
            }
        }
    }
    events
}

/// A line each: counts, command, flags, a fixture by its name and fields, and the contact's age and fields, in their order.
pub fn to_text(events: &[Event]) -> String {
    let mut text = String::new();
    for event in events {
        let (word, [a, b, c]) = match event.counts {
            Counts::Moved(steps) => ("moved", steps.map(i32::from)),
            Counts::Anything(counts) => ("counts", counts),
        };
        let command = match event.command {
            None => "-",
            Some(Command::Arm) => "arm",
            Some(Command::Disarm) => "disarm",
            Some(_) => "clear",
        };
        let flags = event.flags.map(u8::from);
        write!(
            text,
            "{word} {a} {b} {c} {command} {} {} {}",
            flags[0], flags[1], flags[2]
        )
        .unwrap();
        if let Some(fixture) = &event.fixture {
            let (name, fields) = match fixture {
                Fixture::None => ("open", Vec::new()),
                Fixture::Wall {
                    point_m,
                    normal,
                    stiffness_n_per_m: stiffness,
                    damping_n_s_per_m: damping,
                } => (
                    "wall",
                    [&point_m[..], normal, &[*stiffness, *damping]].concat(),
                ),
                Fixture::Coupling {
                    anchor_m,
                    stiffness_n_per_m: stiffness,
                    damping_n_s_per_m: damping,
                } => (
                    "coupling",
                    [&anchor_m[..], &[*stiffness, *damping]].concat(),
                ),
            };
            write!(text, " {name}").unwrap();
            for number in fields {
                write!(text, " {number:?}").unwrap();
            }
        }
        if let Some((age_us, contact)) = &event.contact {
            write!(text, " {age_us} {}", contact.tool).unwrap();
            let numbers = [
                &contact.position_m[..],
                &contact.wrench,
                &contact.tangent,
                &[contact.gap_m],
                &contact.normal,
                &[contact.relaxation_per_s],
            ];
            for number in numbers.concat() {
                write!(text, " {number:?}").unwrap();
            }
            write!(text, " {}", contact.horizon_us).unwrap();
        }
        text.push('\n');
    }
    text
}

/// What [`to_text`] wrote.
pub fn from_text(text: &str) -> Vec<Event> {
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(event_of).collect()
}

fn event_of(line: &str) -> Event {
    let mut words = line.split_whitespace();
    let word = words.next().unwrap();
    let counts: [i32; 3] = numbers(&mut words);
    let command = match words.next().unwrap() {
        "arm" => Some(Command::Arm),
        "disarm" => Some(Command::Disarm),
        "clear" => Some(Command::ClearFault),
        _ => None,
    };
    let flags: [u8; 3] = numbers(&mut words);
    let mut next = words.next();
    let fixture = next.and_then(|name| fixture_of(name, &mut words));
    if fixture.is_some() {
        next = words.next();
    }
    let contact = next.map(|age| {
        let [tool] = numbers(&mut words);
        let position_m = numbers(&mut words);
        let wrench = numbers(&mut words);
        let tangent = numbers(&mut words);
        let [gap_m] = numbers(&mut words);
        let normal = numbers(&mut words);
        let [relaxation_per_s] = numbers(&mut words);
        let [horizon_us] = numbers(&mut words);
        let contact = Contact {
            tool,
            position_m,
            orientation: [0.0, 0.0, 0.0, 1.0],
            wrench,
            tangent,
            gap_m,
            normal,
            relaxation_per_s,
            horizon_us,
        };
        (age.parse().unwrap(), contact)
    });
    Event {
        counts: if word == "moved" {
            Counts::Moved(counts.map(|count| count as i8))
        } else {
            Counts::Anything(counts)
        },
        contact,
        command,
        fixture,
        flags: flags.map(|flag| flag != 0),
    }
}

fn fixture_of<'a>(name: &str, words: &mut impl Iterator<Item = &'a str>) -> Option<Fixture> {
    match name {
        "open" => Some(Fixture::None),
        "wall" => {
            let (point_m, normal) = (numbers(words), numbers(words));
            let [stiffness_n_per_m, damping_n_s_per_m] = numbers(words);
            Some(Fixture::Wall {
                point_m,
                normal,
                stiffness_n_per_m,
                damping_n_s_per_m,
            })
        }
        "coupling" => {
            let anchor_m = numbers(words);
            let [stiffness_n_per_m, damping_n_s_per_m] = numbers(words);
            Some(Fixture::Coupling {
                anchor_m,
                stiffness_n_per_m,
                damping_n_s_per_m,
            })
        }
        _ => None,
    }
}

fn numbers<'a, T: FromStr, const N: usize>(words: &mut impl Iterator<Item = &'a str>) -> [T; N] {
    std::array::from_fn(|_| {
        words
            .next()
            .and_then(|word| word.parse().ok())
            .expect("a number")
    })
}
