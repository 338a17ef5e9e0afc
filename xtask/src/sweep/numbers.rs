//! Numbers of a scene's file, where they stand, and how they are changed. Entry points: [`of`], [`Change`], [`draw`].

use anyhow::{Context, Result};
use std::collections::BTreeMap;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A number in a file.
pub struct Number {
    /// Such as `hand.way_point[2].position_m[1]`.
    pub key: String,
    /// Text in the file.
    pub written: String,
    value: f64,
    is_whole: bool,
    span: Range<usize>,
}

impl Number {
    /// The file's text with something else in its place.
    pub fn replaced(&self, text: &str, changed: &str) -> String {
        let Range { start, end } = self.span;
        let (before, after) = (text.get(..start), text.get(end..));
        [
            before.unwrap_or_default(),
            changed,
            after.unwrap_or_default(),
        ]
        .concat()
    }
}

/// Changes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    Thousandth,
    Thousandfold,
    Zero,
    Negated,
}

impl Change {
    /// All of them.
    pub const ALL: [Change; 4] = [
        Change::Thousandth,
        Change::Thousandfold,
        Change::Zero,
        Change::Negated,
    ];

    fn value(self, number: f64) -> f64 {
        match self {
            Change::Thousandth => 1e-3 * number,
            Change::Thousandfold => 1e3 * number,
            Change::Zero => 0.0,
            Change::Negated => -number,
        }
    }

    /// Whether it makes another number of it.
    pub fn changes(self, number: &Number) -> bool {
        self.value(number.value) != number.value
    }

    /// The number as a file has it then: a whole one where it is whole.
    pub fn of(self, number: &Number) -> String {
        let value = self.value(number.value);
        if number.is_whole && value.fract() == 0.0 {
            format!("{value}")
        } else {
            format!("{value:?}")
        }
    }
}

/// All numbers of a TOML text, in its order.
///
/// # Errors
/// A text that is not TOML.
pub fn of(text: &str) -> Result<Vec<Number>> {
    let table = DeTable::parse(text).context("no TOML")?;
    let mut numbers = Vec::new();
    for (key, value) in table.get_ref() {
        collect(text, key.get_ref(), value, &mut numbers);
    }
    numbers.sort_by_key(|number| number.span.start);
    Ok(numbers)
}

fn collect(text: &str, key: &str, value: &Spanned<DeValue<'_>>, numbers: &mut Vec<Number>) {
    let is_whole = matches!(value.get_ref(), DeValue::Integer(_));
    match value.get_ref() {
        DeValue::Integer(_) | DeValue::Float(_) => {
            let span = value.span();
            let written = text.get(span.clone()).unwrap_or_default();
            // Infinity stays it.
            let number = written.replace('_', "").parse().ok();
            if let Some(value) = number.filter(|value: &f64| value.is_finite()) {
                numbers.push(Number {
                    key: key.to_owned(),
                    written: written.to_owned(),
                    value,
                    is_whole,
                    span,
                });
            }
        }
        DeValue::Array(array) => {
            for (place, value) in array.iter().enumerate() {
                collect(text, &format!("{key}[{place}]"), value, numbers);
            }
        }
        DeValue::Table(table) => {
            for (own, value) in table {
                collect(text, &format!("{key}.{}", own.get_ref()), value, numbers);
            }
        }
        _ => {}
    }
}

/// Returns the first, the middle and the last of numbers whose keys differ only by their places in lists of sections.
pub fn of_each_key(numbers: &[Number]) -> Vec<usize> {
    let mut alike = BTreeMap::<String, Vec<usize>>::new();
    for (place, number) in numbers.iter().enumerate() {
        // Along a vector every entry counts.
        let (sections, last) = match number.key.rsplit_once('.') {
            Some((sections, last)) => (sections, last),
            None => ("", number.key.as_str()),
        };
        let sections: String = sections
            .split('[')
            .map(|part| part.trim_start_matches(|c: char| c.is_ascii_digit()))
            .collect();
        alike
            .entry(format!("{sections}.{last}"))
            .or_default()
            .push(place);
    }
    let mut kept: Vec<usize> = alike
        .into_values()
        .flat_map(|places| {
            let count = places.len();
            let mut kept = vec![places[0], places[count / 2], places[count - 1]];
            kept.dedup();
            kept
        })
        .collect();
    kept.sort_unstable();
    kept
}

/// So many of them, each at most once, in a random order that follows from a seed.
pub fn draw<T>(mut all: Vec<T>, count: usize, seed: u64) -> Vec<T> {
    let mut state = seed;
    // Steele, Lea and Flood 2014.
    let mut next = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    };
    let count = count.min(all.len());
    for place in 0..count {
        let left = (all.len() - place) as u64;
        all.swap(place, place + (next() % left) as usize);
    }
    all.truncate(count);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "seconds = 5.0\n[mesh.slab]\nsize_m = [0.08, 1_0.0, 3e-2]\ndivisions = [20, 20, 8]\n\
                        [[hand.way_point]]\ntime_s = 0.0\n[[hand.way_point]]\ntime_s = 1.5 # then\n[tissue]\npuncture_pa = inf\n";

    #[test]
    fn numbers_are_found_where_they_stand() {
        let numbers = of(TEXT).expect("TOML");
        let keys: Vec<(&str, &str)> = numbers
            .iter()
            .map(|number| (number.key.as_str(), number.written.as_str()))
            .collect();
        assert_eq!(
            keys,
            [
                ("seconds", "5.0"),
                ("mesh.slab.size_m[0]", "0.08"),
                ("mesh.slab.size_m[1]", "1_0.0"),
                ("mesh.slab.size_m[2]", "3e-2"),
                ("mesh.slab.divisions[0]", "20"),
                ("mesh.slab.divisions[1]", "20"),
                ("mesh.slab.divisions[2]", "8"),
                ("hand.way_point[0].time_s", "0.0"),
                ("hand.way_point[1].time_s", "1.5"),
            ]
        );
        let changed = numbers[8].replaced(TEXT, "-1.5");
        assert_eq!(changed, TEXT.replace("1.5", "-1.5"));
        // Both way points, and every entry of a vector.
        assert_eq!(of_each_key(&numbers).len(), 9);
    }

    #[test]
    fn whole_numbers_stay_whole_where_they_can() {
        let numbers = of("n = 20\nx = 0.5\nzero = 0.0\n").expect("TOML");
        let all = |number: &Number| Change::ALL.map(|change| change.of(number));
        assert_eq!(all(&numbers[0]), ["0.02", "20000", "0", "-20"]);
        assert_eq!(all(&numbers[1]), ["0.0005", "500.0", "0.0", "-0.5"]);
        assert!(!Change::ALL.iter().any(|change| change.changes(&numbers[2])));
    }

    #[test]
    fn of_long_lists_three_are_kept() {
        let points: String = (0..9).map(|k| format!("[[p]]\nt = {k}.5\n")).collect();
        let numbers = of(&points).expect("TOML");
        assert_eq!(of_each_key(&numbers), [0, 4, 8]);
    }

    #[test]
    fn a_seed_draws_the_same_and_nothing_twice() {
        let all = || (0..500).collect::<Vec<u32>>();
        let mut drawn = draw(all(), 100, 7);
        assert_eq!(drawn, draw(all(), 100, 7));
        assert_ne!(drawn, draw(all(), 100, 8));
        drawn.sort_unstable();
        drawn.dedup();
        assert_eq!(drawn.len(), 100);
        assert_eq!(draw(all(), 1000, 7).len(), 500);
    }
}
