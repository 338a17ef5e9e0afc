//! Which elements take part in a step: those that move, and those that may begin to.
//!
//! Entry point: [`Awake`]. What is at rest and undisturbed costs nothing, so that a step follows what moves and
//! not the size of the mesh.

use super::links::Links;
use crate::in_place::clone_in_place;

/// Bits of elements that are awake, and of those with a link to one.
#[derive(Debug)]
pub(super) struct Awake {
    awake: Vec<u64>,
    near: Vec<u64>,
    count: usize,
    nodes: usize,
    /// Elements all of whose neighbours are awake: they need not look.
    inside: Vec<u64>,
}

clone_in_place!(Awake {
    awake,
    near,
    count,
    nodes,
    inside,
});

impl Awake {
    /// All asleep.
    pub fn new(nodes: usize) -> Self {
        let words = nodes.div_ceil(64);
        Self {
            awake: vec![0; words],
            near: vec![0; words],
            count: 0,
            nodes,
            inside: vec![0; words],
        }
    }

    /// Elements that are awake.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether all are.
    pub fn all(&self) -> bool {
        self.count == self.nodes
    }

    /// Wakes an element; says whether it was asleep.
    #[inline]
    pub fn wake(&mut self, node: u32, links: &Links) -> bool {
        let (word, bit) = (node as usize / 64, 1 << (node % 64));
        if self.awake[word] & bit != 0 {
            return false;
        }
        self.awake[word] |= bit;
        self.count += 1;
        self.near[word] |= bit;
        for beside in links.beside(node as usize) {
            self.near[beside.to as usize / 64] |= 1 << (beside.to % 64);
        }
        true
    }

    /// Wakes the neighbours of an element and calls `woken` with each that was asleep.
    pub fn wake_beside(&mut self, node: u32, links: &Links, mut woken: impl FnMut(u32)) {
        let (word, bit) = (node as usize / 64, 1 << (node % 64));
        if self.inside[word] & bit != 0 {
            return;
        }
        self.inside[word] |= bit;
        for beside in links.beside(node as usize) {
            if self.wake(beside.to, links) {
                woken(beside.to);
            }
        }
    }

    /// Puts to sleep every element of which `rests` says so.
    pub fn put_to_sleep(&mut self, links: &Links, rests: impl Fn(usize) -> bool) {
        let mut changed = false;
        for word in 0..self.awake.len() {
            let mut rest = self.awake[word];
            while rest != 0 {
                let bit = rest.trailing_zeros();
                rest &= rest - 1;
                let node = word * 64 + bit as usize;
                if rests(node) {
                    self.awake[word] &= !(1 << bit);
                    self.count -= 1;
                    changed = true;
                }
            }
        }
        if !changed {
            return;
        }
        self.near.fill(0);
        self.inside.fill(0);
        for word in 0..self.awake.len() {
            let mut rest = self.awake[word];
            self.near[word] |= rest;
            while rest != 0 {
                let node = word * 64 + rest.trailing_zeros() as usize;
                rest &= rest - 1;
                for beside in links.beside(node) {
                    self.near[beside.to as usize / 64] |= 1 << (beside.to % 64);
                }
            }
        }
    }

    /// Elements that are awake, ascending.
    #[inline]
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        bits(self.awake.iter().copied())
    }

    /// Elements that are awake and may have a neighbour that is not, ascending.
    pub fn rim(&self) -> impl Iterator<Item = usize> + '_ {
        let words = self.awake.iter().zip(&self.inside);
        bits(words.map(|(awake, inside)| awake & !inside))
    }

    /// Elements that are awake or next to one that is, ascending: together they own every link of an
    /// element that is awake.
    #[inline]
    pub fn near(&self) -> impl Iterator<Item = usize> + '_ {
        bits(self.near.iter().copied())
    }
}

/// Indices of set bits, ascending.
struct Bits<I> {
    words: I,
    rest: u64,
    base: usize,
}

fn bits<I: Iterator<Item = u64>>(words: I) -> Bits<I> {
    Bits {
        words,
        rest: 0,
        base: 0usize.wrapping_sub(64),
    }
}

impl<I: Iterator<Item = u64>> Iterator for Bits<I> {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        while self.rest == 0 {
            self.rest = self.words.next()?;
            self.base = self.base.wrapping_add(64);
        }
        let bit = self.rest.trailing_zeros() as usize;
        self.rest &= self.rest - 1;
        Some(self.base.wrapping_add(bit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use sutura_mesh::slab;

    #[test]
    fn near_owns_every_link_of_what_is_awake_also_after_sleep() {
        let mesh = slab([0.05; 3], [5; 3]).expect("a slab");
        let fat = Material {
            youngs_modulus_pa: 3e3,
            poisson_ratio: 0.45,
        };
        let links = Links::new(&mesh, &fat.into(), 1e3, 1.0).expect("links");
        let mut awake = Awake::new(links.nodes());
        let check = |awake: &Awake| {
            let near: Vec<usize> = awake.near().collect();
            assert!(near.is_sorted());
            for node in awake.iter() {
                assert!(near.contains(&node));
                for beside in links.beside(node) {
                    assert!(near.contains(&(beside.to as usize)));
                }
            }
            assert_eq!(awake.count(), awake.iter().count());
        };
        assert!(awake.wake(100, &links) && !awake.wake(100, &links));
        check(&awake);
        let mut woken = Vec::new();
        awake.wake_beside(100, &links, |node| woken.push(node));
        assert_eq!(woken.len(), links.beside(100).len());
        check(&awake);
        awake.put_to_sleep(&links, |node| node != 100);
        assert_eq!(awake.iter().collect::<Vec<_>>(), [100]);
        assert_eq!(awake.near().count(), links.beside(100).len() + 1);
        check(&awake);
        // Having slept, its neighbours can be woken again.
        woken.clear();
        awake.wake_beside(100, &links, |node| woken.push(node));
        assert_eq!(woken.len(), links.beside(100).len());
        awake.put_to_sleep(&links, |_| true);
        assert_eq!((awake.count(), awake.near().count()), (0, 0));
    }
}
