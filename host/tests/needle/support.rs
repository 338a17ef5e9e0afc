//! Meshes to drive needles through, and ways through them.

use super::oracle::{NOT, Oracle};
use nalgebra::Vector3;
use sutura_host::mesh::{HalfFaces, TetMesh, read_msh};
use sutura_host::needle::{Curve, Geometry, Hierarchy, Joints, Slack};
use sutura_testkit::Random;

/// Tissue in a place, with a hierarchy made elsewhere.
pub struct Body {
    pub mesh: HalfFaces,
    pub at: Vec<Vector3<f64>>,
    pub hierarchy: Hierarchy,
    pub slack_m: f64,
}

impl Body {
    pub fn at_rest(mesh: &TetMesh) -> Self {
        let at = mesh.points_m().iter().map(|p| Vector3::from(*p)).collect();
        Self::new(mesh.half_faces().clone(), at)
    }

    pub fn new(mesh: HalfFaces, at: Vec<Vector3<f64>>) -> Self {
        let hierarchy = Hierarchy::new(&mesh, |node| at[node as usize]);
        Self {
            mesh,
            at,
            hierarchy,
            slack_m: 0.0,
        }
    }

    /// Moved smoothly by up to about `by`; the hierarchy stays where it was.
    pub fn deformed(mut self, random: &mut Random, by: f64) -> Self {
        let (low, high) = self.bounds();
        let size = (high - low).amax();
        let waves: Vec<_> = (0..4)
            .map(|_| {
                (
                    random.vector() * 4.0 / size,
                    random.unit() * 6.3,
                    random.vector() * by / 4.0,
                )
            })
            .collect();
        let mut slack_m = 0.0f64;
        for at in &mut self.at {
            let moved: Vector3<f64> = waves
                .iter()
                .map(|(wave, phase, way)| way * (wave.dot(at) + phase).sin())
                .sum();
            *at += moved;
            slack_m = slack_m.max(moved.norm());
        }
        self.slack_m = slack_m;
        self
    }

    pub fn geometry(&self) -> Geometry<'_, impl Fn(u32) -> Vector3<f64> + '_> {
        Geometry {
            mesh: &self.mesh,
            hierarchy: &self.hierarchy,
            slack: Slack::Everywhere(self.slack_m),
            at: |node: u32| self.at[node as usize],
        }
    }

    pub fn bounds(&self) -> (Vector3<f64>, Vector3<f64>) {
        let first = self.at[0];
        let both = self.at.iter();
        both.fold((first, first), |(low, high), at| {
            (low.inf(at), high.sup(at))
        })
    }

    pub fn volumes(&self) -> impl Iterator<Item = f64> + '_ {
        self.mesh.cells().iter().map(|cell| {
            let [a, b, c, d] = cell.map(|node| self.at[node as usize]);
            (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
        })
    }
}

/// A mesh with its nodes moved at random by so much of `spacing`, nowhere inside out.
pub fn jittered(mesh: &TetMesh, random: &mut Random, by: f64) -> TetMesh {
    let points = mesh
        .points_m()
        .iter()
        .map(|p| (Vector3::from(*p) + random.vector() * by).into())
        .collect();
    TetMesh::new(points, mesh.cells().to_vec()).expect("a small jitter turns no cell over")
}

pub fn generated(name: &str) -> TetMesh {
    let path = format!("{}/../tests/data/{name}.msh", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).expect("the mesh is there");
    read_msh(&text, 1.0).expect("a sound mesh")
}

/// A needle's way along one line or circle: at `0` it is outside.
#[derive(Clone, Copy)]
pub struct Way {
    base: Curve,
    /// Whether the centre of its circle is the origin, to the last bit, wherever on it the needle is.
    centred: bool,
    /// Along the axis of such a circle.
    aside: Vector3<f64>,
    /// How far it goes.
    pub reach: f64,
}

impl Way {
    pub fn line(
        start: Vector3<f64>,
        tangent: Vector3<f64>,
        inward: Vector3<f64>,
        length: f64,
        reach: f64,
    ) -> Self {
        Self {
            base: Curve {
                start,
                tangent,
                inward,
                curvature: 0.0,
                length,
                joints: Joints::default(),
            },
            centred: false,
            aside: Vector3::zeros(),
            reach,
        }
    }

    /// From wholly outside of `body` to its far side and beyond, through a point well inside.
    pub fn any_line(body: &Body, random: &mut Random, length: f64) -> Self {
        let (low, high) = body.bounds();
        let size = (high - low).norm();
        let through = (low + high) / 2.0 + (high - low).component_mul(&random.vector()) * 0.4;
        let tangent = random.direction();
        let aside = tangent.cross(&random.direction()).normalize();
        // Nothing of the body is farther from a point in its box than this.
        let back = size + length;
        Self::line(
            through - tangent * back,
            tangent,
            aside,
            length,
            2.0 * size + length,
        )
    }

    /// About a point beside the body, so that a part of the circle that a needle of `length` fits in is outside; at
    /// times with a needle of more than half a turn.
    pub fn any_arc(body: &Body, random: &mut Random, length: f64) -> Self {
        let (low, high) = body.bounds();
        let size = (high - low).norm();
        let middle = (low + high) / 2.0;
        let out = random.direction();
        let through = middle + (high - low).component_mul(&random.vector()) * 0.3;
        // Its farthest point is out of the body's ball by more than a half of what the needle bends.
        let (radius, length) = if random.unit() < 0.3 {
            let radius = random.between(1.0, 1.3) * size;
            (radius, random.between(3.3, 4.1) * radius)
        } else {
            (random.between(0.7, 1.2) * size + 0.5 * length, length)
        };
        let inward = (out + random.direction() * 0.3).normalize();
        let tangent = inward.cross(&random.direction()).normalize();
        let centre = through + inward * radius;
        let curvature = radius.recip();
        // The needle's middle is opposite `through`.
        let angle = std::f64::consts::PI - 0.5 * length * curvature;
        let base = Curve {
            start: centre - inward * radius,
            tangent,
            inward,
            curvature,
            length,
            joints: Joints::default(),
        };
        let base = Curve {
            start: base.at(angle * radius),
            tangent: base.tangent_at(angle * radius),
            inward: base.inward_at(angle * radius),
            ..base
        };
        Self {
            base,
            centred: false,
            aside: Vector3::zeros(),
            reach: std::f64::consts::TAU * radius - 1.01 * length,
        }
    }

    /// On the circle of a radius about the origin, from `angle` in the plane of two axes, towards the second.
    pub fn about_origin(
        radius: f64,
        axes: [Vector3<f64>; 2],
        angle: f64,
        length: f64,
        reach: f64,
    ) -> Self {
        let curvature = radius.recip();
        assert_eq!(curvature.recip(), radius);
        let (sin, cos) = angle.sin_cos();
        let inward = -(axes[0] * cos + axes[1] * sin);
        Self {
            base: Curve {
                start: -inward * radius,
                tangent: axes[1] * cos - axes[0] * sin,
                inward,
                curvature,
                length,
                joints: Joints::default(),
            },
            centred: true,
            aside: Vector3::zeros(),
            reach,
        }
    }

    /// Along the axis of its circle.
    pub fn moved(mut self, by: Vector3<f64>) -> Self {
        self.aside = by;
        self
    }

    /// Only the part that goes through the body, with a little before and after it; `None` if it goes through
    /// less than a number of faces.
    pub fn trimmed(mut self, body: &Body, least: usize) -> Option<Self> {
        let length = self.base.length;
        let whole = [0.0, self.reach + length];
        let found = Oracle::new(&body.mesh, &body.at).crossings(&self.base, whole, NOT);
        let (first, last) = (found.first()?.alpha, found.last()?.alpha);
        let skip = (first - 1.05 * length).max(0.0);
        self.reach = (last + 0.05 * length - skip).min(self.reach - skip);
        self.base = self.needle(skip);
        (found.len() >= least).then_some(self)
    }

    pub fn length(&self) -> f64 {
        self.base.length
    }

    /// The needle so far along.
    pub fn needle(&self, along: f64) -> Curve {
        let inward = self.base.inward_at(along);
        Curve {
            start: if self.centred {
                self.aside - inward * self.base.curvature.recip()
            } else {
                self.base.at(along)
            },
            tangent: self.base.tangent_at(along),
            inward,
            ..self.base
        }
    }
}
