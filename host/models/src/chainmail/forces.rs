//! Forces and energy of the links, and in the same pass which elements have a link beyond its limits.
//!
//! Entry points: [`Pass`], four links at a time in the registers that `pulp` finds, with the same bits on every processor;
//! [`Springs::renew`] for the few elements that move after it.

use super::awake::Awake;
use super::links::{Links, difference};
use super::quad::Quad;
use pulp::{Simd, WithSimd};

/// An element in one cache line.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(super) struct Element {
    /// Position \[m\].
    pub x: Quad,
    /// Force of its links at `x` \[N\]; of what sleeps, meaningless.
    pub f: Quad,
}

/// From `a` to `b`.
#[inline]
pub(super) fn between(a: &Element, b: &Element) -> [f64; 3] {
    difference(&a.x.xyz(), &b.x.xyz())
}

/// Springs of the links. A spring's energy is k l0^2 e^2 / 2 with Green's strain e = (l^2 / l0^2 - 1) / 2, which
/// needs no root; beyond the limits its e stays, so that a link on its way back does not explode.
#[derive(Clone, Copy, Debug)]
pub(super) struct Springs {
    /// Least and greatest 2 e that a spring feels.
    felt: (f64, f64),
    /// Least and greatest 2 e of a link that need not be looked at.
    within: (f64, f64),
}

impl Springs {
    /// For links whose strain limits are between `least` and `greatest`; to be looked at is what exceeds `least` by
    /// more than `tolerance`.
    pub fn new(least: f64, greatest: f64, tolerance: f64) -> Self {
        let twice_green = |strain: f64| (1.0 + strain) * (1.0 + strain).abs() - 1.0;
        Self {
            felt: (twice_green(-greatest), twice_green(greatest)),
            within: (
                twice_green(-least - tolerance),
                twice_green(least + tolerance),
            ),
        }
    }

    /// Slope of the steepest spring over its k.
    pub fn slope(&self) -> f64 {
        1.0 + 1.5 * self.felt.1
    }

    /// Force on one element and the energies it owns, anew; returns what they gained \[J\].
    pub fn renew(&self, links: &Links, i: usize, at: &mut [Element], energy_of: &mut [f64]) -> f64 {
        let places = links.owned.places_of(i);
        let (mut own, mut energy) = (Quad::ZERO, 0.0);
        for link in links.beside(i) {
            let d = at[link.to as usize].x - at[i].x;
            let change = d.square() - link.rest_sq;
            let (low, high) = self.felt;
            let felt = change.min(high * link.rest_sq).max(low * link.rest_sq);
            let pull = links.owned.spring(link.place) * felt;
            own = own + pull * d;
            if places.contains(&(link.place as usize)) {
                energy += 0.25 * pull * (2.0 * change - felt);
            }
        }
        at[i].f = own;
        let gained = energy - energy_of[i];
        energy_of[i] = energy;
        gained
    }
}

/// One pass over the links.
#[derive(Debug)]
pub(super) struct Pass<'a> {
    /// Springs of the links.
    pub springs: Springs,
    /// The links.
    pub links: &'a Links,
    /// Elements whose forces are computed.
    pub awake: &'a Awake,
    /// Elements, (n).
    pub at: &'a mut [Element],
    /// Energies \[J\] by owner, (n).
    pub energy_of: &'a mut [f64],
    /// Owners of links that are to be looked at, found anew.
    pub beyond: &'a mut Vec<u32>,
}

impl WithSimd for Pass<'_> {
    type Output = f64;

    /// Returns what all energies gained \[J\]. The registers are the compiler's choice: `S` only says which the
    /// processor has.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let Self {
            springs,
            links,
            awake,
            at,
            energy_of,
            beyond,
        } = self;
        beyond.clear();
        for i in awake.near() {
            at[i].f = Quad::ZERO;
        }
        let ((low, high), (least, greatest)) = (springs.felt, springs.within);
        let mut gained = 0.0;
        for i in awake.near() {
            let x = at[i].x;
            let (mut own, mut energy, mut excess) = (Quad::ZERO, Quad::ZERO, Quad::ZERO);
            for four in links.owned.fours(i) {
                let d = four.to.map(|j| at[j as usize].x - x);
                let rest_sq = Quad(four.rest_sq);
                let change = Quad::squares(d) - rest_sq;
                excess = excess
                    .most(change - greatest * rest_sq)
                    .most(least * rest_sq - change);
                let felt = change.least(high * rest_sq).most(low * rest_sq);
                let pull = Quad(four.spring.map(f64::from)) * felt;
                energy = energy + pull * (change + change - felt);
                for lane in 0..4 {
                    let force = pull.0[lane] * d[lane];
                    own = own + force;
                    let other = &mut at[four.to[lane] as usize].f;
                    *other = *other - force;
                }
            }
            at[i].f = at[i].f + own;
            let energy_j = 0.25 * energy.sum();
            gained += energy_j - energy_of[i];
            energy_of[i] = energy_j;
            if excess.0.iter().any(|excess| *excess > 0.0) {
                beyond.push(i as u32);
            }
        }
        gained
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Material;
    use pulp::{Arch, Scalar};
    use sutura_mesh::slab;

    const FAT: Material = Material {
        youngs_modulus_pa: 3e3,
        poisson_ratio: 0.45,
    };

    /// Links of a small slab, and its elements shaken so that some links are beyond a limit of 0.2.
    fn shaken() -> (Links, Awake, Vec<Element>) {
        let mesh = slab([0.02, 0.03, 0.01], [3, 4, 2]).expect("a slab");
        let links = Links::new(&mesh, &FAT.into(), 1000.0, 1.0).expect("links");
        let mut awake = Awake::new(links.nodes());
        let mut at = Vec::new();
        for (node, rest) in links.rest_m.iter().enumerate() {
            awake.wake(node as u32, &links);
            let shake = |axis: usize| 1.2e-3 * ((7 * node + 3 * axis) as f64).sin();
            at.push(Element {
                x: Quad::of([0, 1, 2].map(|axis| rest[axis] + shake(axis))),
                f: Quad::ZERO,
            });
        }
        (links, awake, at)
    }

    fn pass<'a>(
        links: &'a Links,
        awake: &'a Awake,
        at: &'a mut [Element],
        energy_of: &'a mut [f64],
        beyond: &'a mut Vec<u32>,
    ) -> Pass<'a> {
        Pass {
            springs: Springs::new(0.2, 0.2, 1e-3),
            links,
            awake,
            at,
            energy_of,
            beyond,
        }
    }

    #[test]
    fn forces_are_minus_the_gradient_of_the_energy() {
        let (links, awake, mut at) = shaken();
        let (mut energy_of, mut beyond) = (vec![0.0; links.nodes()], Vec::new());
        let energy = |at: &mut [Element], energy_of: &mut [f64]| {
            let mut beyond = Vec::new();
            let gained = Scalar.vectorize(pass(&links, &awake, at, energy_of, &mut beyond));
            let sum: f64 = energy_of.iter().sum();
            (gained, sum)
        };
        let (gained, sum) = energy(&mut at, &mut energy_of);
        assert!(sum > 0.0 && (gained - sum).abs() < 1e-12 * sum);
        let forces: Vec<Quad> = at.iter().map(|at| at.f).collect();
        let largest = forces.iter().map(|f| f.square()).fold(0.0, f64::max).sqrt();
        for node in [0, 17, 31, 59] {
            for axis in 0..3 {
                let mut over = |by: f64| {
                    let mut moved = at.clone();
                    moved[node].x.0[axis] += by;
                    energy(&mut moved, &mut energy_of).1
                };
                let slope = (over(1e-7) - over(-1e-7)) / 2e-7;
                let force = forces[node].0[axis];
                assert!((slope + force).abs() < 1e-6 * largest, "{slope} {force}");
            }
        }
        // Found beyond limits is exactly what owns a link that is.
        Scalar.vectorize(pass(&links, &awake, &mut at, &mut energy_of, &mut beyond));
        let owners = (0..links.nodes() as u32).filter(|i| {
            links.owned.of(*i as usize).any(|link| {
                let d = between(&at[*i as usize], &at[link.to as usize]);
                let length = (crate::chainmail::links::square(d) / link.rest_sq).sqrt();
                !(0.799..=1.201).contains(&length)
            })
        });
        assert!(!beyond.is_empty() && beyond.len() < links.nodes());
        assert!(owners.eq(beyond.iter().copied()));
    }

    #[test]
    fn wide_registers_give_the_same_bits_and_renewing_the_same_forces() {
        let (links, awake, mut at) = shaken();
        let mut plain = at.clone();
        let (mut energy_of, mut beyond) = (vec![0.0; links.nodes()], Vec::new());
        let (mut plain_energy, mut plain_beyond) = (energy_of.clone(), Vec::new());
        Arch::new().dispatch(pass(&links, &awake, &mut at, &mut energy_of, &mut beyond));
        Scalar.vectorize(pass(
            &links,
            &awake,
            &mut plain,
            &mut plain_energy,
            &mut plain_beyond,
        ));
        assert_eq!((&energy_of, &beyond), (&plain_energy, &plain_beyond));
        for (wide, plain) in at.iter().zip(&plain) {
            assert_eq!(wide.f, plain.f);
        }
        let springs = Springs::new(0.2, 0.2, 1e-3);
        for node in 0..links.nodes() {
            at[node].f = Quad::ZERO;
            let gained = springs.renew(&links, node, &mut at, &mut energy_of);
            assert!(gained.abs() <= 1e-14 * plain_energy[node]);
            let off = at[node].f - plain[node].f;
            assert!(off.square().sqrt() < 1e-13 * plain[node].f.square().sqrt());
        }
    }

    /// The tightest limit says what is to be looked at, not what is felt.
    #[test]
    fn springs_feel_up_to_the_widest_limit() {
        let (links, awake, at) = shaken();
        let forces = |least: f64| {
            let (mut at, mut energy_of, mut beyond) =
                (at.clone(), vec![0.0; links.nodes()], Vec::new());
            let mut pass = pass(&links, &awake, &mut at, &mut energy_of, &mut beyond);
            pass.springs = Springs::new(least, 0.9, 1e-3);
            let energy = Scalar.vectorize(pass);
            let forces: Vec<Quad> = at.iter().map(|at| at.f).collect();
            (energy, forces, beyond.len())
        };
        let (tight, wide) = (forces(0.1), forces(0.9));
        assert!(tight.2 > 0 && wide.2 == 0);
        assert_eq!((tight.0, tight.1), (wide.0, wide.1));
    }
}
