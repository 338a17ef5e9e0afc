//! Bars: bodies of grips.
//!
//! Entry points: [`Bar`] for what is constant, [`BarState`] for what evolves.

use super::shape::PIECE_RADII;
use super::touch::{MOST_TOUCHES, Touch};
use crate::needle::Curve;
use crate::source::tool::Hardest;
use crate::tool::{MOST_FRICTION, Shape, Tool};
use nalgebra::{Isometry3, Point3, Vector3};
use serde::Serialize;

/// Longest piece of a bar's way near the surface, in mean edges: of thick ones less than of their radius.
const PIECE_EDGES: f64 = 0.1;

/// A round bar with half a ball at both ends, fixed to a grip that holds needles or threads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Centre of the ball in front, in the frame of the grip \[m\], (3).
    pub offset_m: [f64; 3],
    /// From the ball behind to the one in front, unit vector in the frame of the grip, (3).
    pub axis: [f64; 3],
    /// Of the balls \[m\].
    pub radius_m: f64,
    /// From centre to centre \[m\].
    pub length_m: f64,
    /// Coulomb's coefficient on tissue.
    pub friction: f64,
}

impl Bar {
    /// What is wrong with it.
    pub fn flaw(&self) -> Option<String> {
        let sizes = [("radius", self.radius_m), ("length", self.length_m)];
        let wrong = sizes
            .iter()
            .find(|(_, size)| !(*size > 0.0 && size.is_finite()));
        if let Some((what, size)) = wrong {
            return Some(format!(
                "its {what} is {size} m; it must be above zero and finite"
            ));
        }
        let is_unit = (Vector3::from(self.axis).norm() - 1.0).abs() < 1e-6;
        if !(is_unit && self.offset_m.iter().all(|x| x.is_finite())) {
            return Some("its axis must be a unit vector, and its offset finite".to_owned());
        }
        let friction = self.friction;
        let is_sound = (0.0..=MOST_FRICTION).contains(&friction);
        let limits = || format!("its friction is {friction}; it must be from 0 to {MOST_FRICTION}");
        (!is_sound).then(limits)
    }

    /// Centres of its balls, the one in front first, of a grip at `pose` \[m\].
    pub(crate) fn ends(&self, pose: &Isometry3<f64>) -> [Vector3<f64>; 2] {
        let front = (pose * Point3::from(self.offset_m)).coords;
        let way = pose.rotation * Vector3::from(self.axis) * self.length_m;
        [front, front - way]
    }

    /// From its front to its back, of a grip at `pose`.
    pub(crate) fn curve(&self, pose: &Isometry3<f64>) -> Option<Curve> {
        let [front, back] = self.ends(pose);
        Curve::segment(&front, &back)
    }

    /// Its shape as that of a tool.
    pub(crate) fn capsule(&self) -> Tool {
        let axis = Vector3::from(self.axis);
        let across = axis.cross(&Vector3::ith(axis.iamin(), 1.0)).normalize();
        let shape = Shape::Capsule {
            radius_m: self.radius_m,
            length_m: self.length_m,
        };
        Tool {
            axis: self.axis,
            side: across.into(),
            ..Tool::new(shape, self.offset_m)
        }
    }

    /// Longest piece of its way near a surface with edges of `edge_m` \[m\].
    pub(crate) fn piece_m(&self, edge_m: f64) -> f64 {
        (PIECE_RADII * self.radius_m).min(PIECE_EDGES * edge_m)
    }
}

/// A bar and the tool that carries it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarPart {
    /// Id of the tool.
    pub tool: u8,
    /// What it carries.
    pub bar: Bar,
}

/// One bar.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct BarState {
    /// Id of the tool that carries it.
    pub tool: u8,
    /// Of the grip; nothing before the first step that has the tool.
    pub pose: Option<Isometry3<f64>>,
    /// Whether it has been outside of the tissue as a whole: before that it touches nothing.
    pub has_been_outside: bool,
    /// Where it touches, or may come to.
    pub touches: Vec<Touch>,
    /// Whether it is within some edges of the surface.
    pub is_near: bool,
    pub next_id: u32,
    /// Whether it has come into the tissue, and has not been outside since.
    #[serde(skip)]
    pub is_sunk: bool,
    /// Largest force on its way in, and its place.
    #[serde(skip)]
    pub hardest: Option<Hardest>,
}

impl BarState {
    /// On a tool, nowhere.
    pub fn new(tool: u8) -> Self {
        Self {
            tool,
            pose: None,
            has_been_outside: false,
            touches: Vec::with_capacity(MOST_TOUCHES),
            is_near: true,
            next_id: 0,
            is_sunk: false,
            hardest: None,
        }
    }

    /// As a copy of `other`, without new memory.
    pub fn copy_from(&mut self, other: &Self) {
        let Self {
            tool,
            pose,
            has_been_outside,
            touches,
            is_near,
            next_id,
            is_sunk,
            hardest,
        } = self;
        *tool = other.tool;
        (*pose, *has_been_outside) = (other.pose, other.has_been_outside);
        (*is_near, *next_id) = (other.is_near, other.next_id);
        (*is_sunk, *hardest) = (other.is_sunk, other.hardest);
        touches.clone_from(&other.touches);
    }

    /// Puts it elsewhere, whatever lies in between.
    pub fn put(&mut self, pose: Isometry3<f64>) {
        self.forget();
        self.pose = Some(pose);
        self.is_sunk = false;
    }

    /// Forgets its contact: it has come into the tissue, and touches nothing until all of it is outside.
    pub fn forget(&mut self) {
        self.has_been_outside = false;
        self.is_sunk = true;
        self.hardest = None;
        self.touches.clear();
    }
}

/// `Vec::clone` would not keep the room for touches.
impl Clone for BarState {
    fn clone(&self) -> Self {
        let mut copy = Self::new(self.tool);
        copy.copy_from(self);
        copy
    }
}
