//! Links by the element that owns them, in fours of a cache line each.
//!
//! Entry point: [`Fours::new`]. Of the two ends of a link either may own it.

use super::links::accumulate;
use std::ops::Range;

/// Four links of the element that owns them, in one cache line. Where it owns fewer, the rest lead to itself and have
/// no spring.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Four {
    /// Squares of the rest lengths \[m^2\].
    pub rest_sq: [f64; 4],
    /// k / (2 l0^2) \[N/m^3\]; in single precision they fit, and both ends use the same.
    pub spring: [f32; 4],
    /// The other elements.
    pub to: [u32; 4],
}

/// A link as its owner sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Owned {
    /// Square of the rest length \[m^2\].
    pub rest_sq: f64,
    /// The other element.
    pub to: u32,
    /// k / (2 l0^2) \[N/m^3\].
    pub spring: f64,
    /// Its place, below [`Fours::places`].
    pub place: usize,
}

/// A link before it has its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct End {
    /// One of its elements.
    pub owner: u32,
    /// The other.
    pub to: u32,
    /// As [`Four::rest_sq`].
    pub rest_sq: f64,
    /// As [`Four::spring`].
    pub spring: f32,
}

/// Links by owner; constant.
#[derive(Clone, Debug)]
pub(super) struct Fours {
    start: Vec<u32>,
    fours: Vec<Four>,
}

impl Fours {
    /// Of links ascending by their owner, which is their lower end still.
    pub fn new(mut ends: Vec<End>, nodes: usize) -> Self {
        share_out(&mut ends, nodes);
        let (start, fours) = pack(&ends, nodes);
        Self { start, fours }
    }

    /// Places for links; more than there are links, since elements own them by fours.
    pub fn places(&self) -> usize {
        4 * self.fours.len()
    }

    /// Links that an element owns, by fours. Of the two ends of a link one owns it.
    #[inline(always)]
    pub fn fours(&self, node: usize) -> &[Four] {
        &self.fours[self.start[node] as usize..self.start[node + 1] as usize]
    }

    /// Links that an element owns, one by one.
    #[inline]
    pub fn of(&self, node: usize) -> impl Iterator<Item = Owned> + '_ {
        let first = 4 * self.start[node] as usize;
        let all = self.fours(node).iter().enumerate();
        let each = all.flat_map(move |(index, four)| {
            [0, 1, 2, 3].map(|lane| Owned {
                rest_sq: four.rest_sq[lane],
                to: four.to[lane],
                spring: f64::from(four.spring[lane]),
                place: first + 4 * index + lane,
            })
        });
        each.filter(move |link| link.to as usize != node)
    }

    /// Places of the links that an element owns.
    #[inline]
    pub fn places_of(&self, node: usize) -> Range<usize> {
        4 * self.start[node] as usize..4 * self.start[node + 1] as usize
    }

    /// Spring of the link at a place, k / (2 l0^2) \[N/m^3\].
    #[inline]
    pub fn spring(&self, place: u32) -> f64 {
        f64::from(self.fours[place as usize / 4].spring[place as usize % 4])
    }
}

/// Gives links, ascending by their lower end, to either end so that nearly every element owns a multiple of four.
fn share_out(ends: &mut [End], nodes: usize) {
    let mut owns = vec![0; nodes];
    for of_lower in ends.chunk_by_mut(|a, b| a.owner == b.owner) {
        let lower = of_lower[0].owner as usize;
        let spare = ((owns[lower] + of_lower.len()) % 4).min(of_lower.len());
        owns[lower] += of_lower.len() - spare;
        for end in &mut of_lower[..spare] {
            owns[end.to as usize] += 1;
            (end.owner, end.to) = (end.to, end.owner);
        }
    }
    ends.sort_by_key(|end| (end.owner, end.to));
}

/// Links by fours, and where each element's begin; ascending by owner.
fn pack(ends: &[End], nodes: usize) -> (Vec<u32>, Vec<Four>) {
    let (mut start, mut fours) = (vec![0; nodes + 1], Vec::new());
    for of_one in ends.chunk_by(|a, b| a.owner == b.owner) {
        let owner = of_one[0].owner;
        for some in of_one.chunks(4) {
            let mut four = Four {
                rest_sq: [0.0; 4],
                spring: [0.0; 4],
                to: [owner; 4],
            };
            for (lane, end) in some.iter().enumerate() {
                four.rest_sq[lane] = end.rest_sq;
                four.spring[lane] = end.spring;
                four.to[lane] = end.to;
            }
            fours.push(four);
            start[owner as usize + 1] += 1;
        }
    }
    accumulate(&mut start);
    (start, fours)
}

#[cfg(test)]
mod tests {
    use crate::Material;
    use crate::chainmail::links::Links;
    use sutura_mesh::slab;

    #[test]
    fn links_are_owned_by_fours() {
        let mesh = slab([0.02; 3], [8; 3]).expect("a slab");
        let fat = Material {
            youngs_modulus_pa: 3e3,
            poisson_ratio: 0.45,
        };
        let links = Links::new(&mesh, &fat.into(), 1000.0, 1.0).expect("links");
        let ends: usize = (0..links.nodes()).map(|i| links.beside(i).len()).sum();
        // Only where too few neighbours are higher is there nobody to give spare links to. (With every link
        // owned by its lower end 4 places in 10 are empty.)
        let empty = links.owned.places() - ends / 2;
        assert!(empty <= ends / 2 / 20, "{empty} of {}", ends / 2);
    }
}
