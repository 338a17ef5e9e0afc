//! What is deformed: bodies, what they are made of, what is done to them, and where one looks.
//!
//! Entry point: [`all`]. All but the bent beam up to the first slab are after zhang-2017, 5.3 (its x points upwards: the bottom is x = 0),
//! which has no line for some of them: see each case's `about`.

use super::lattice::{Lattice, Shape};
use sutura_host::mesh::MeshError;
pub use sutura_host::registry::Substance;
use sutura_models::Material;

/// A force over part of the surface.
#[derive(Clone, Copy, Debug)]
pub struct Traction {
    /// Where, by places in the unit cube.
    pub there: fn([f64; 3]) -> bool,
    /// Summed \[N\].
    pub force_n: [f64; 3],
}

/// Nodes on which the largest error of one component is taken.
#[derive(Clone, Copy, Debug)]
pub struct RedLine {
    /// Where, by places in the unit cube.
    pub there: fn([f64; 3]) -> bool,
    /// 0 to 2.
    pub axis: usize,
}

/// One case.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Word for tables and `--only`.
    pub name: &'static str,
    /// What is done, and what was chosen where the source says nothing.
    pub about: &'static str,
    /// The body.
    pub shape: Shape,
    /// Cubes at level 1.
    pub divisions: [usize; 3],
    /// Levels of the full table; see [`Case::truth_level`].
    pub levels: &'static [usize],
    /// What it is made of.
    pub substance: Substance,
    /// Displacement \[m\] of nodes that are held, by places in the unit cube; zero for those that only stay.
    pub held: fn([f64; 3]) -> Option<[f64; 3]>,
    /// Load besides.
    pub traction: Option<Traction>,
    /// Where one looks.
    pub red_line: RedLine,
    /// Steps in which loads and displacements grow, steps in which they stay, and their length \[s\].
    pub ramp: usize,
    /// See `ramp`.
    pub rest: usize,
    /// See `ramp`.
    pub step_s: f64,
    /// Whether the short table has it.
    pub short: bool,
}

impl Case {
    /// Levels that are measured; the first in the short table.
    pub fn levels_of(&self, full: bool) -> &'static [usize] {
        if full { self.levels } else { &self.levels[..1] }
    }

    /// Level at which quadratic cells are the truth: the finest that is measured, 2 in the short table.
    pub fn truth_level(&self, full: bool) -> usize {
        let finest = self.levels.iter().copied().max().unwrap_or(1);
        if full { finest.max(2) } else { 2 }
    }

    /// The body at a level.
    ///
    /// # Errors
    /// None for the cases of this module.
    pub fn lattice(&self, level: usize) -> Result<Lattice, MeshError> {
        Lattice::new(self.shape, self.divisions.map(|n| n * level))
    }
}

/// zhang-2017 5.3: brain.
const BRAIN: Substance = Substance {
    material: Material {
        youngs_modulus_pa: 3_000.0,
        poisson_ratio: 0.49,
    },
    fibres: None,
    relaxation: None,
    density_kg_per_m3: 1_000.0,
};

/// zhang-2017 5.3.3: eta = 2 mu along z.
const FIBRED: Substance = Substance {
    fibres: Some((2.0, [0.0, 0.0, 1.0])),
    ..BRAIN
};

/// zhang-2017 3.3.5.4: liver.
const LIVER: Substance = Substance {
    material: Material {
        youngs_modulus_pa: 3_500.0,
        poisson_ratio: 0.47,
    },
    fibres: None,
    relaxation: None,
    density_kg_per_m3: 1_060.0,
};

const BEAM: Case = Case {
    name: "beam-tension",
    about: "2 x 0.2 x 0.2 m, one end fixed, 0.8 N along it over the other; line: an edge, u_x (the source has none)",
    shape: |[x, y, z]| [2.0 * x, 0.2 * y, 0.2 * z],
    divisions: [20, 2, 2],
    levels: &[1, 2, 3],
    substance: BRAIN,
    held: |[x, _, _]| (x == 0.0).then_some([0.0; 3]),
    traction: Some(Traction {
        there: |[x, _, _]| x == 1.0,
        force_n: [0.8, 0.0, 0.0],
    }),
    red_line: RedLine {
        there: |[_, y, z]| y == 1.0 && z == 1.0,
        axis: 0,
    },
    ramp: 10,
    rest: 10,
    step_s: 0.01,
    short: true,
};

const CYLINDER: Case = Case {
    name: "cylinder-compressed",
    about: "2 m long, radius 0.5 m, both faces clamped, one moved 0.4 m inwards; line: XZ plane with the side, u_x",
    shape: cylinder,
    divisions: [4, 4, 6],
    held: |[_, _, z]| clamped_ends(z, -0.4),
    traction: None,
    red_line: RedLine {
        there: |[x, y, _]| x == 1.0 && y == 0.5,
        axis: 0,
    },
    ..BEAM
};

const CUBE: Case = Case {
    name: "cube-sheared",
    about: "2 m, bottom fixed, top moved 0.5 m along z; line: y = 1 m on the face z = 2 m, u_z",
    shape: |[x, y, z]| [2.0 * x, 2.0 * y, 2.0 * z],
    divisions: [4, 4, 4],
    held: |[x, _, _]| clamped_cube(x, [0.0, 0.0, 0.5]),
    red_line: RedLine {
        there: |[_, y, z]| y == 0.5 && z == 1.0,
        axis: 2,
    },
    ..CYLINDER
};

const SLAB: Case = Case {
    name: "indent-flat",
    about: "slab 80 x 80 x 30 mm on a fixed bottom, 20 x 20 mm of its top pressed 6 mm; line: middle of the top, u_z",
    shape: |[x, y, z]| [0.08 * x, 0.08 * y, 0.03 * z],
    divisions: [8, 8, 2],
    substance: LIVER,
    held: |at| {
        if at[2] == 0.0 {
            Some([0.0; 3])
        } else {
            under_punch(at).then_some([0.0, 0.0, -0.006])
        }
    },
    red_line: RedLine {
        there: |[_, y, z]| y == 0.5 && z == 1.0,
        axis: 2,
    },
    ..CYLINDER
};

/// All cases.
pub fn all() -> Vec<Case> {
    vec![
        BEAM,
        Case {
            name: "beam-bending",
            about: "the same beam, 0.05 N across it over the end; line: an edge, u_z",
            traction: Some(Traction {
                there: |[x, _, _]| x == 1.0,
                force_n: [0.0, 0.0, -0.05],
            }),
            red_line: RedLine {
                there: |[_, y, z]| y == 1.0 && z == 1.0,
                axis: 2,
            },
            ..BEAM
        },
        CYLINDER,
        Case {
            name: "cylinder-stretched",
            about: "the same cylinder, the face moved 0.4 m outwards; line: XZ plane with the side, u_x",
            held: |[_, _, z]| clamped_ends(z, 0.4),
            short: false,
            ..CYLINDER
        },
        CUBE,
        Case {
            name: "cube-fibres-stretched",
            about: "2 m, fibres along z with eta = 2 mu, top moved 0.3 m up; line: y = 1 m on the face z = 2 m, u_z (the source has none)",
            substance: FIBRED,
            held: |[x, _, _]| clamped_cube(x, [0.3, 0.0, 0.0]),
            short: false,
            ..CUBE
        },
        Case {
            name: "cube-fibres-compressed",
            about: "2 m, fibres along z with eta = 2 mu, top moved 0.3 m down; line: y = 1 m on the face z = 2 m, u_z (the source has none)",
            substance: FIBRED,
            held: |[x, _, _]| clamped_cube(x, [-0.3, 0.0, 0.0]),
            short: false,
            ..CUBE
        },
        Case {
            name: "cube-relaxation",
            about: "the same cube without fibres, half of the stress fading in 0.58 s: pressed 0.3 m in 0.5 s, held for 4.5 s; the force is that at the end",
            substance: Substance {
                relaxation: Some((0.5, 0.58)),
                ..BRAIN
            },
            held: |[x, _, _]| clamped_cube(x, [-0.3, 0.0, 0.0]),
            ramp: 10,
            rest: 90,
            step_s: 0.05,
            short: false,
            ..CUBE
        },
        SLAB,
        Case {
            name: "cube-pressed",
            about: "20 mm, bottom fixed, 0.172 N downwards over the middle two thirds of the top; line: middle of the top, u_z (the source prints neither load nor patch nor line)",
            shape: |[x, y, z]| [0.02 * x, 0.02 * y, 0.02 * z],
            divisions: [6, 6, 4],
            levels: &[1, 2],
            held: |[_, _, z]| (z == 0.0).then_some([0.0; 3]),
            traction: Some(Traction {
                there: |[x, y, z]| z == 1.0 && (x - 0.5).abs() < 0.34 && (y - 0.5).abs() < 0.34,
                force_n: [0.0, 0.0, -PRESSED_N],
            }),
            short: false,
            ..SLAB
        },
        Case {
            name: "indent-sphere",
            about: "the same slab under a sphere of 25 mm pressed 5 mm, its profile given to the same nodes; line: middle of the top, u_z",
            held: |at| {
                if at[2] == 0.0 {
                    return Some([0.0; 3]);
                }
                let [x, y] = [0, 1].map(|axis| 0.08 * (at[axis] - 0.5));
                let depth = 0.005 - (x * x + y * y) / (2.0 * 0.025);
                under_punch(at).then_some([0.0, 0.0, -depth])
            },
            short: false,
            ..SLAB
        },
        Case {
            name: "organ-probed",
            about: "a lobe of 0.16 x 0.10 x 0.05 m, held at its thick end and over the middle of its bottom, a patch of the top pressed 8 mm by a probe of 20 mm; line: middle of the top, u_z",
            shape: lobe,
            divisions: [8, 8, 4],
            levels: &[1, 2],
            held: |[x, y, z]| {
                let support = x == 0.0 || (z == 0.0 && middle_half(x) && middle_half(y));
                let probe = z == 1.0 && (0.5..=0.75).contains(&x) && (0.375..=0.625).contains(&y);
                if support {
                    Some([0.0; 3])
                } else {
                    probe.then_some([0.0, 0.0, -0.008])
                }
            },
            short: false,
            ..SLAB
        },
        Case {
            name: "wound-closed",
            about: "skin 60 x 40 x 12 mm with a groove 15 mm wide and 6 mm deep, bottom and sides held, the rims of its middle half drawn together by 5 mm each; line: middle of the top, u_x",
            shape: groove,
            divisions: [8, 4, 2],
            held: |[x, y, z]| {
                if z == 0.0 || x == 0.0 || x == 1.0 {
                    return Some([0.0; 3]);
                }
                let rim = z == 1.0 && middle_half(y);
                let left = rim && (0.25..=0.375).contains(&x);
                let right = rim && (0.625..=0.75).contains(&x);
                if left {
                    Some([0.005, 0.0, 0.0])
                } else {
                    right.then_some([-0.005, 0.0, 0.0])
                }
            },
            red_line: RedLine {
                there: |[_, y, z]| y == 0.5 && z == 1.0,
                axis: 0,
            },
            short: false,
            ..SLAB
        },
    ]
}

/// zhang-2017, 3.3.5.4, prints no load: with this one the mean displacement is the 1.08 mm of its 9.7 %.
const PRESSED_N: f64 = 0.172;

fn middle_half(x: f64) -> bool {
    (0.25..=0.75).contains(&x)
}

fn under_punch([x, y, z]: [f64; 3]) -> bool {
    z == 1.0 && (0.375..=0.625).contains(&x) && (0.375..=0.625).contains(&y)
}

fn clamped_ends(z: f64, way: f64) -> Option<[f64; 3]> {
    if z == 0.0 {
        Some([0.0; 3])
    } else {
        (z == 1.0).then_some([0.0, 0.0, way])
    }
}

fn clamped_cube(x: f64, way: [f64; 3]) -> Option<[f64; 3]> {
    if x == 0.0 {
        Some([0.0; 3])
    } else {
        (x == 1.0).then_some(way)
    }
}

/// Squares become circles (Shirley and Chiu 1997): its corners stay well shaped if divisions are even.
fn cylinder([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (a, b) = (2.0 * x - 1.0, 2.0 * y - 1.0);
    let (x, y) = (
        a * (1.0 - 0.5 * b * b).sqrt(),
        b * (1.0 - 0.5 * a * a).sqrt(),
    );
    [0.5 * x, 0.5 * y, 2.0 * z]
}

/// Round, thick at x = 0, thin and bent down at the other end.
fn lobe([x, y, z]: [f64; 3]) -> [f64; 3] {
    let [a, b, c] = [x, y, z].map(|s| 2.0 * s - 1.0);
    // Two thirds of the way from the cube to the ball.
    let round = |a: f64, b: f64, c: f64| {
        let ball = (1.0 - 0.5 * b * b - 0.5 * c * c + b * b * c * c / 3.0).sqrt();
        a * (1.0 / 3.0 + 2.0 / 3.0 * ball)
    };
    let (a, b, c) = (round(a, b, c), round(b, c, a), round(c, a, b));
    let thin = 1.0 - 0.35 * (0.5 + 0.5 * a);
    [
        0.08 * a,
        0.05 * b * (1.0 - 0.15 * a),
        0.025 * c * thin - 0.012 * (0.5 + 0.5 * a) * (0.5 + 0.5 * a),
    ]
}

/// A slab whose top goes down to a valley at the middle.
fn groove([x, y, z]: [f64; 3]) -> [f64; 3] {
    let from_middle = (x - 0.5).abs();
    let along = 0.5 + 0.5 * (std::f64::consts::TAU * (y - 0.5)).cos();
    let depth = 0.006 * along * (1.0 - from_middle / 0.125).max(0.0);
    [0.06 * x, 0.04 * y, z * (0.012 - depth)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every case has cells of positive volume, something that holds it, and a line.
    #[test]
    fn cases_are_sound() {
        for case in all() {
            for level in case.levels {
                let lattice = case.lattice(*level).expect(case.name);
                let held = lattice.unit.iter().filter_map(|at| (case.held)(*at));
                assert!(held.count() >= 4, "{}", case.name);
                let line = lattice.unit.iter().filter(|at| (case.red_line.there)(**at));
                assert!(line.count() >= 5, "{}", case.name);
                if let Some(traction) = case.traction {
                    assert!(!lattice.faces(traction.there).is_empty(), "{}", case.name);
                }
            }
        }
    }
}
