//! Which of things that are counted from 0 are meant.

/// Marks on things, a bit each.
#[derive(Clone, Debug, Default)]
pub(crate) struct Marks(Vec<u64>);

impl Marks {
    /// None of so many.
    pub fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(64)])
    }

    /// Whether a thing is marked.
    pub fn has(&self, thing: u32) -> bool {
        self.0[thing as usize / 64] & bit(thing) != 0
    }

    /// Marks a thing; whether it was not.
    pub fn set(&mut self, thing: u32) -> bool {
        let word = &mut self.0[thing as usize / 64];
        let before = std::mem::replace(word, *word | bit(thing));
        before != *word
    }

    /// Marks what others mark, too.
    pub fn set_all(&mut self, others: &Self) {
        for (word, other) in self.0.iter_mut().zip(&others.0) {
            *word |= other;
        }
    }

    /// Takes all marks away.
    pub fn clear(&mut self) {
        self.0.fill(0);
    }

    /// What is marked, ascending.
    pub fn each(&self) -> impl Iterator<Item = u32> {
        places(self.0.iter().copied())
    }

    /// What is marked here and not there, ascending.
    pub fn each_but(&self, others: &Self) -> impl Iterator<Item = u32> {
        let words = self.0.iter().zip(&others.0);
        places(words.map(|(word, other)| word & !other))
    }

    /// Visits what is marked, ascending, and takes the marks away.
    pub fn take(&mut self, visit: impl FnMut(u32)) {
        places(self.0.iter_mut().map(std::mem::take)).for_each(visit);
    }
}

fn bit(thing: u32) -> u64 {
    1 << (thing % 64)
}

/// What words mark, ascending.
fn places(words: impl Iterator<Item = u64>) -> impl Iterator<Item = u32> {
    let marked = (0u32..).step_by(64).zip(words);
    // Most mark nothing.
    let marked = marked.filter(|(_, word)| *word != 0);
    marked.flat_map(|(first, word)| ones(word).map(move |place| first + place))
}

/// Places of a word's ones, ascending.
fn ones(mut word: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let place = word.trailing_zeros();
        word &= word.wrapping_sub(1);
        (place < u64::BITS).then_some(place)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_visited_in_order() {
        let mut marks = Marks::new(200);
        let mut others = Marks::new(200);
        for thing in [199, 3, 64, 63] {
            assert!(marks.set(thing) && !marks.set(thing) && marks.has(thing));
        }
        others.set(64);
        others.set(65);
        assert_eq!(marks.each().collect::<Vec<_>>(), [3, 63, 64, 199]);
        assert_eq!(marks.each_but(&others).collect::<Vec<_>>(), [3, 63, 199]);
        let mut taken = Vec::new();
        marks.take(|thing| taken.push(thing));
        assert_eq!(taken, [3, 63, 64, 199]);
        assert_eq!(marks.each().next(), None);
        marks.set_all(&others);
        assert_eq!(marks.each().collect::<Vec<_>>(), [64, 65]);
        others.clear();
        assert!(!others.has(64) && marks.has(64));
    }
}
