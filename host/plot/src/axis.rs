//! One axis: what it spans, where its ticks are, and what lies beyond it.
//!
//! Entry points: [`Scale::over`], [`Scale::place`], [`Scale::ticks`].

use crate::text::width;
use libm::{ceil, floor, log10, pow};

/// What an axis shows.
#[derive(Clone, Debug, Default)]
pub struct Axis {
    /// Beside it, with its unit.
    pub title: String,
    /// Logarithmic: decades are labelled, and what is not above 0 has no place.
    pub logarithmic: bool,
    /// What is larger is marked at the edge, and counted.
    pub most: Option<f64>,
}

/// Of the spread of the middle eight tenths of all scattered points: what is farther from them is beyond the axis.
const FAR: f64 = 3.0;
/// With fewer points none is far from the rest.
const FEW: usize = 8;
/// Least spread that counts as one, in decades and as a part of the value.
const LEAST_SPREAD: (f64, f64) = (0.5, 0.1);

/// An axis that knows its values. Its coordinate is the value, or the value's decimal logarithm.
#[derive(Debug)]
pub struct Scale {
    pub low: f64,
    pub high: f64,
    logarithmic: bool,
}

/// Where a value is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// Coordinate.
    Inside(f64),
    /// Below the low end.
    Below,
    /// Above the high end.
    Above,
    /// Not above 0, on a logarithmic axis.
    NotAboveZero,
    /// Infinite or not a number.
    NoNumber,
}

/// A line across the picture, with or without its number.
#[derive(Clone, Debug)]
pub struct Tick {
    /// Coordinate.
    pub at: f64,
    /// None for fine lines.
    pub label: Option<Label>,
}

/// A number as it is written: `base`, with `exponent` raised after it.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    pub base: String,
    pub exponent: String,
}

/// Size of an exponent over that of its base.
pub const RAISED: f64 = 0.78;

impl Label {
    fn plain(base: &str) -> Self {
        Label {
            base: signed(base),
            exponent: String::new(),
        }
    }

    fn raised(base: &str, exponent: i32) -> Self {
        Label {
            base: signed(base),
            exponent: signed(&exponent.to_string()),
        }
    }

    /// Width \[px\] in letters of a size \[px\].
    pub fn width(&self, size: f64) -> f64 {
        width(&self.base, size) + width(&self.exponent, RAISED * size)
    }
}

impl Scale {
    /// Spans all that is joined, and what is scattered but for what lies far from the rest.
    pub fn over(axis: &Axis, joined: &[f64], scattered: &[f64]) -> Self {
        let coordinate = |value: &f64| {
            let is_suited = value.is_finite() && (!axis.logarithmic || *value > 0.0);
            let is_shown = axis.most.is_none_or(|most| *value <= most);
            let at = if axis.logarithmic {
                log10(*value)
            } else {
                *value
            };
            (is_suited && is_shown).then_some(at)
        };
        let mut scattered: Vec<f64> = scattered.iter().filter_map(coordinate).collect();
        scattered.sort_by(f64::total_cmp);
        let (least, most) = fences(&scattered, axis.logarithmic);
        let near = scattered
            .into_iter()
            .filter(|at| (least..=most).contains(at));
        let all = near.chain(joined.iter().filter_map(coordinate));
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
            (low.min(at), high.max(at))
        });
        let (low, high) = if low > high {
            (0.0, 1.0)
        } else {
            widened(low, high, axis.logarithmic)
        };
        Scale {
            low,
            high,
            logarithmic: axis.logarithmic,
        }
    }

    pub fn place(&self, value: f64) -> Place {
        if !value.is_finite() {
            return Place::NoNumber;
        }
        if self.logarithmic && value <= 0.0 {
            return Place::NotAboveZero;
        }
        let at = if self.logarithmic {
            log10(value)
        } else {
            value
        };
        if at < self.low {
            Place::Below
        } else if at > self.high {
            Place::Above
        } else {
            Place::Inside(at)
        }
    }

    /// As many as `fits` lets stand side by side: it is asked with coordinates and labels.
    pub fn ticks(&self, fits: impl Fn(&[Tick]) -> bool) -> Vec<Tick> {
        let choices = if self.logarithmic {
            self.logarithmic_choices()
        } else {
            self.linear_choices()
        };
        let labelled = |ticks: &[Tick]| -> Vec<Tick> {
            let with = ticks.iter().filter(|tick| tick.label.is_some());
            with.cloned().collect()
        };
        let mut choices = choices.into_iter();
        choices
            .find(|ticks| fits(&labelled(ticks)))
            .unwrap_or_default()
    }

    /// From most labels to fewest.
    fn logarithmic_choices(&self) -> Vec<Vec<Tick>> {
        let decades = self.high - self.low;
        let first = floor(self.low) as i32;
        let last = ceil(self.high) as i32;
        let choice = |every: i32, digits: &[u8]| -> Vec<Tick> {
            let fine = if decades < 5.0 { 1..=9 } else { 1..=1 };
            let each = (first..=last)
                .flat_map(|exponent| fine.clone().map(move |digit: u8| (exponent, digit)));
            let tick = |(exponent, digit): (i32, u8)| Tick {
                at: f64::from(exponent) + log10(f64::from(digit)),
                label: (digits.contains(&digit) && exponent.rem_euclid(every) == 0)
                    .then(|| power(digit, exponent)),
            };
            let inside = |tick: &Tick| (self.low..=self.high).contains(&tick.at);
            each.map(tick).filter(inside).collect()
        };
        let mut choices = Vec::new();
        if decades < 1.3 {
            choices.push(choice(1, &[1, 2, 3, 4, 6, 8]));
        }
        if decades < 3.2 {
            choices.push(choice(1, &[1, 2, 5]));
        }
        choices.extend([1, 2, 3, 5, 10, 20, 50, 100].map(|every| choice(every, &[1])));
        choices
    }

    fn linear_choices(&self) -> Vec<Vec<Tick>> {
        let span = self.high - self.low;
        let largest = self.low.abs().max(self.high.abs());
        let exponent = floor(log10(largest)) as i32;
        // Digits alone where they are few.
        let exponent = if (-3..5).contains(&exponent) {
            0
        } else {
            exponent
        };
        let unit = pow(10.0, f64::from(exponent));
        let choice = |count: u32| -> Vec<Tick> {
            let raw = span / f64::from(count);
            let decade = floor(log10(raw)) as i32;
            let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * pow(10.0, f64::from(decade)));
            let step = steps.into_iter().find(|step| *step >= raw).unwrap_or(raw);
            let decimals = exponent.saturating_sub(decade).clamp(0, 12) as usize;
            let first = ceil(self.low / step) as i64;
            let last = floor(self.high / step) as i64;
            // At the ends of what a number can be, steps are none.
            let last = last.min(first.saturating_add(20));
            (first..=last)
                .map(|index| {
                    let at = index as f64 * step;
                    let base = shortest(at / unit, decimals);
                    let label = match (index, exponent) {
                        (0, _) => Label::plain("0"),
                        (_, 0) => Label::plain(&base),
                        _ => Label::raised(&format!("{base}\u{d7}10"), exponent),
                    };
                    Tick {
                        at,
                        label: Some(label),
                    }
                })
                .collect()
        };
        [8, 6, 4, 3, 2, 1].map(choice).into()
    }
}

/// Tukey's fences, but of the middle eight tenths: a half is little where some points are at one place.
fn fences(sorted: &[f64], logarithmic: bool) -> (f64, f64) {
    if sorted.len() < FEW {
        return (f64::NEG_INFINITY, f64::INFINITY);
    }
    let last = (sorted.len() - 1) as f64;
    let low = sorted[ceil(0.1 * last) as usize];
    let high = sorted[floor(0.9 * last) as usize];
    let least = if logarithmic {
        LEAST_SPREAD.0
    } else {
        LEAST_SPREAD.1 * low.abs().max(high.abs())
    };
    let room = FAR * (high - low).max(least);
    (low - room, high + room)
}

/// With some room, and never so narrow that it has no two ticks.
fn widened(low: f64, high: f64, logarithmic: bool) -> (f64, f64) {
    let middle = 0.5 * low + 0.5 * high;
    let least = if logarithmic || middle == 0.0 {
        1.0
    } else {
        1e-3 * middle.abs()
    };
    let half = (0.5 * high - 0.5 * low).max(0.5 * least);
    (middle - 1.08 * half, middle + 1.08 * half)
}

fn power(digit: u8, exponent: i32) -> Label {
    if digit == 1 {
        return Label::raised("10", exponent);
    }
    if (-3..4).contains(&exponent) {
        let decimals = exponent.min(0).unsigned_abs() as usize;
        let value = f64::from(digit) * pow(10.0, f64::from(exponent));
        return Label::plain(&format!("{value:.decimals$}"));
    }
    Label::raised(&format!("{digit}\u{d7}10"), exponent)
}

/// With a minus as wide as a plus.
fn signed(number: &str) -> String {
    number.replace('-', "\u{2212}")
}

/// Without zeros that say nothing.
fn shortest(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(logarithmic: bool) -> Axis {
        Axis {
            logarithmic,
            ..Axis::default()
        }
    }

    fn labels(scale: &Scale) -> Vec<String> {
        let ticks = scale.ticks(|ticks| ticks.len() <= 8);
        let labels = ticks.into_iter().filter_map(|tick| tick.label);
        labels
            .map(|label| format!("{}^{}", label.base, label.exponent))
            .collect()
    }

    #[test]
    fn decades_are_powers_and_as_many_as_fit() {
        let decades = Scale::over(&axis(true), &[2e-3, 600.0], &[]);
        assert_eq!(
            labels(&decades),
            ["10^\u{2212}2", "10^\u{2212}1", "10^0", "10^1", "10^2"]
        );
        let many = Scale::over(&axis(true), &[1e-2, 1e22], &[]);
        assert_eq!(labels(&many).first().map(String::as_str), Some("10^0"));
        assert!((3..=8).contains(&labels(&many).len()));
        let few = Scale::over(&axis(true), &[7.0, 40.0], &[]);
        assert!(labels(&few).len() >= 3, "{:?}", labels(&few));
    }

    #[test]
    fn numbers_of_a_linear_axis_are_short_and_right() {
        let plain = Scale::over(&axis(false), &[-0.2, 1.1], &[]);
        assert_eq!(labels(&plain)[0..3], ["\u{2212}0.2^", "0^", "0.2^"]);
        let large = Scale::over(&axis(false), &[0.0, 1e10], &[]);
        assert!(
            labels(&large).contains(&"1\u{d7}10^10".to_owned()),
            "{:?}",
            labels(&large)
        );
        let equal = Scale::over(&axis(false), &[5.0, 5.0], &[]);
        assert!(labels(&equal).len() >= 2 && labels(&equal).iter().any(|label| label == "5^"));
    }

    #[test]
    fn one_far_point_does_not_press_the_others_together() {
        let mut values: Vec<f64> = (1..40).map(f64::from).collect();
        values.push(1e10);
        for logarithmic in [true, false] {
            let scale = Scale::over(&axis(logarithmic), &[], &values);
            assert_eq!(scale.place(1e10), Place::Above);
            assert!(matches!(scale.place(39.0), Place::Inside(_)));
            // A line that goes there is meant to.
            let scale = Scale::over(&axis(logarithmic), &values, &[]);
            assert!(matches!(scale.place(1e10), Place::Inside(_)));
        }
    }

    #[test]
    fn what_has_no_place_says_why() {
        let scale = Scale::over(&axis(true), &[1.0, 100.0, f64::NAN, -5.0], &[]);
        assert_eq!(scale.place(f64::NAN), Place::NoNumber);
        assert_eq!(scale.place(f64::INFINITY), Place::NoNumber);
        assert_eq!(scale.place(-5.0), Place::NotAboveZero);
        assert_eq!(scale.place(0.0), Place::NotAboveZero);
        assert_eq!(scale.place(1e-9), Place::Below);
        let limited = Axis {
            most: Some(50.0),
            ..axis(true)
        };
        let scale = Scale::over(&limited, &[1.0, 20.0, 100.0], &[]);
        assert_eq!(scale.place(100.0), Place::Above);
    }
}
