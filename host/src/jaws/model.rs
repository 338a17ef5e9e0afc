//! What is constant about jaws.
//!
//! Entry points: [`Jaws`], [`JawsPart`].

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Length of the pads, if nobody says \[m\].
pub const DEFAULT_LENGTH_M: f64 = 0.020;
/// Their width \[m\].
pub const DEFAULT_WIDTH_M: f64 = 0.005;
/// Angle between them while they are open \[degree\].
pub const DEFAULT_OPENING_DEG: f64 = 60.0;
/// Points that they hold at most.
pub const DEFAULT_POINTS: usize = 8;
/// The fewest points that bear a moment about any axis.
pub const FEWEST_POINTS: usize = 3;
/// The most points of one pair of jaws.
pub const MOST_POINTS: usize = 32;

/// Two pads at a hinge, fixed to a grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jaws {
    /// Middle of the pads' front edges while they are closed, in the frame of the grip \[m\], (3).
    pub offset_m: [f64; 3],
    /// From the hinge to there, unit vector in the frame of the grip, (3).
    pub axis: [f64; 3],
    /// Along the hinge, unit vector across the axis, (3).
    pub side: [f64; 3],
    /// From the hinge to the front \[m\].
    pub length_m: f64,
    /// Along the hinge \[m\].
    pub width_m: f64,
    /// Angle between the pads while they are open \[rad\].
    pub opening_rad: f64,
    /// Force with which the pads press on what is between them \[N\]; infinite: nothing slips.
    pub clamp_n: f64,
    /// Coulomb's coefficient of both pads together: `friction * clamp_n` is what they hold in their plane.
    pub friction: f64,
    /// Most points that they hold, from [`FEWEST_POINTS`] to [`MOST_POINTS`].
    pub points: usize,
    /// Largest force over the area of a pad that tissue bears \[Pa\]: beyond it the jaws tear off. Infinite: never.
    pub strength_pa: f64,
}

/// Jaws and the tool that carries them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JawsPart {
    /// Id of the tool.
    pub tool: u8,
    /// What it carries.
    pub jaws: Jaws,
}

impl Jaws {
    /// That point down, with the sizes of most graspers.
    pub fn new(clamp_n: f64, friction: f64) -> Self {
        Self {
            offset_m: [0.0; 3],
            axis: [0.0, 0.0, -1.0],
            side: [1.0, 0.0, 0.0],
            length_m: DEFAULT_LENGTH_M,
            width_m: DEFAULT_WIDTH_M,
            opening_rad: DEFAULT_OPENING_DEG.to_radians(),
            clamp_n,
            friction,
            points: DEFAULT_POINTS,
            strength_pa: f64::INFINITY,
        }
    }

    /// What is wrong with them.
    pub fn flaw(&self) -> Option<String> {
        let Self {
            axis,
            side,
            opening_rad,
            ..
        } = self;
        let (axis, side) = (Vector3::from(*axis), Vector3::from(*side));
        let units = [axis.norm(), side.norm()].map(|norm| (norm - 1.0).abs() < 1e-6);
        let is_frame = units == [true; 2] && axis.dot(&side).abs() < 1e-6;
        let sizes = [self.length_m, self.width_m];
        if !(is_frame && self.offset_m.iter().all(|x| x.is_finite())) {
            Some(
                "axis and side must be unit vectors across each other, and the offset finite"
                    .into(),
            )
        } else if !sizes.iter().all(|size| *size > 0.0 && size.is_finite()) {
            Some(format!(
                "the pads' sizes are {sizes:?} m; they must be above zero"
            ))
        } else if !(*opening_rad > 0.0 && *opening_rad < std::f64::consts::PI) {
            Some(format!(
                "they open by {opening_rad} rad; it must be between 0 and half a turn"
            ))
        } else if self.clamp_n.is_nan() || self.clamp_n < 0.0 {
            Some(format!(
                "they clamp with {} N; it must not be below zero",
                self.clamp_n
            ))
        } else if !(self.friction >= 0.0 && self.friction.is_finite()) {
            Some(format!(
                "the friction is {}; it must be finite and not below zero",
                self.friction
            ))
        } else if !(FEWEST_POINTS..=MOST_POINTS).contains(&self.points) {
            Some(format!(
                "{} points; {FEWEST_POINTS} to {MOST_POINTS} are possible",
                self.points
            ))
        } else if self.strength_pa.is_nan() || self.strength_pa <= 0.0 {
            Some(format!(
                "tissue bears {} Pa; it must be above zero",
                self.strength_pa
            ))
        } else {
            None
        }
    }

    /// What the pads hold in their plane \[N\].
    pub fn limit_n(&self) -> f64 {
        if self.friction == 0.0 {
            return 0.0;
        }
        self.friction * self.clamp_n
    }

    /// Force at which they tear off \[N\].
    pub fn strength_n(&self) -> f64 {
        self.strength_pa * self.length_m * self.width_m
    }

    /// Unit vectors across the pads, along their axis, and along the hinge, of a grip that is turned so.
    pub(crate) fn frame(&self, turned: &UnitQuaternion<f64>) -> [Vector3<f64>; 3] {
        let (axis, side) = (Vector3::from(self.axis), Vector3::from(self.side));
        [axis.cross(&side), axis, side].map(|direction| turned * direction)
    }

    /// Where a point in the grip's frame is between the pads: from the hinge along the axis, along the hinge from the pads'
    /// middle, and across from their plane \[m\], (3).
    pub(crate) fn in_pads(&self, local_m: &Vector3<f64>) -> Vector3<f64> {
        let [across, axis, side] = self.frame(&UnitQuaternion::identity());
        let from = local_m - Vector3::from(self.offset_m);
        Vector3::new(
            self.length_m + from.dot(&axis),
            from.dot(&side),
            from.dot(&across),
        )
    }

    /// Places between the open pads of a grip at `pose`, at most `apart_m` from each other \[m\].
    pub(crate) fn between(&self, pose: &Isometry3<f64>, apart_m: f64) -> Vec<Vector3<f64>> {
        let parts = |length_m: f64| (length_m / apart_m).ceil().max(1.0) as u32;
        let spread = move |length_m: f64| {
            let count = parts(length_m);
            (0..=count).map(move |k| length_m * f64::from(k) / f64::from(count))
        };
        let slope = (0.5 * self.opening_rad).tan();
        let [across, ..] = self.frame(&pose.rotation);
        let along = spread(self.length_m);
        let places = along.flat_map(|along_m| {
            let gape_m = slope * along_m;
            let flat = spread(self.width_m).map(move |aside_m| (along_m, aside_m));
            flat.flat_map(move |place| {
                spread(2.0 * gape_m).map(move |far_m| (place, far_m - gape_m))
            })
        });
        let places = places.map(|((along_m, aside_m), far_m)| {
            self.on_pads(pose, (along_m, aside_m - 0.5 * self.width_m)) + across * far_m
        });
        places.collect()
    }

    /// The other way: the place in the world of a point of the pads' plane, of a grip at `pose` \[m\].
    pub(crate) fn on_pads(
        &self,
        pose: &Isometry3<f64>,
        (along_m, aside_m): (f64, f64),
    ) -> Vector3<f64> {
        let [_, axis, side] = self.frame(&pose.rotation);
        let front = pose.translation.vector + pose.rotation * Vector3::from(self.offset_m);
        front + axis * (along_m - self.length_m) + side * aside_m
    }
}
