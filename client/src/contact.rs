//! What a simulator knows of a contact: the force at a pose, how it changes from there, and when it begins.
//!
//! Entry points: [`Contact::touching`], [`Contact::apart`], [`Contact::force`].

use crate::Pose;
use sutura_shared::wire::message;

/// Contact of the grip at one pose. The console goes on from it by itself until the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Force on the grip at that pose \[N\], (3), world frame.
    pub force_n: [f32; 3],
    /// Moment on the grip about itself \[N m\], (3); consoles with three motors render none.
    pub moment_nm: [f32; 3],
    /// d (force, moment) / d (position, rotation vector) \[N/m, N, N m/rad\], (6 x 6), row by row; of a spring that
    /// pushes back its diagonal is negative. Only its symmetric part travels: the skew part follows from the moment.
    /// While `gap_m` > 0: just after touching.
    pub tangent: [[f32; 6]; 6],
    /// Way along `-normal` until the grip touches \[m\]; 0 in contact.
    pub gap_m: f32,
    /// Unit vector out of what is touched, (3): a force against it is not rendered.
    pub normal: [f32; 3],
    /// Rate at which the force relaxes at a held pose \[1/s\]; 0 for most.
    pub relaxation_per_s: f32,
}

impl Contact {
    /// Pushed with `force_n` \[N\] by something whose surface has the outward unit `normal`. How the force changes with
    /// the grip is added by [`with_stiffness`](Self::with_stiffness).
    pub fn touching(force_n: [f32; 3], normal: [f32; 3]) -> Contact {
        Contact {
            force_n,
            moment_nm: [0.0; 3],
            tangent: [[0.0; 6]; 6],
            gap_m: 0.0,
            normal,
            relaxation_per_s: 0.0,
        }
    }

    /// Touches nothing yet: `gap_m` \[m\] away from something with the outward unit `normal`. With a stiffness the
    /// console begins to push where the gap ends, without waiting for the next frame.
    pub fn apart(gap_m: f32, normal: [f32; 3]) -> Contact {
        Contact {
            gap_m,
            ..Contact::touching([0.0; 3], normal)
        }
    }

    /// A force and nothing else \[N\]: the console holds it until the next one, whatever the grip does. Without a
    /// stiffness a rendered wall is as soft as its rate is slow; give one wherever it is known.
    pub fn force(force_n: [f32; 3]) -> Contact {
        let length = force_n.iter().map(|f| f * f).sum::<f32>().sqrt();
        let normal = if length > 0.0 && length.is_finite() {
            force_n.map(|f| f / length)
        } else {
            [0.0, 0.0, 1.0]
        };
        Contact::touching(force_n, normal)
    }

    /// With d force / d position \[N/m\], (3 x 3), in the place of what was there.
    pub fn with_stiffness(mut self, stiffness: [[f32; 3]; 3]) -> Contact {
        self.tangent = [[0.0; 6]; 6];
        for (row, given) in self.tangent.iter_mut().zip(stiffness) {
            for (entry, value) in row.iter_mut().zip(given) {
                *entry = value;
            }
        }
        self
    }

    /// As the wire carries it: for the pose that it was computed for, to be used for `horizon_us` \[us\].
    pub(crate) fn frame(&self, pose: &Pose, horizon_us: u32) -> message::Contact {
        let ([fx, fy, fz], [mx, my, mz]) = (self.force_n, self.moment_nm);
        message::Contact {
            tool: 0,
            position_m: pose.position_m,
            orientation: pose.orientation,
            wrench: [fx, fy, fz, mx, my, mz],
            tangent: pack_symmetric(&self.tangent),
            gap_m: self.gap_m,
            normal: self.normal,
            relaxation_per_s: self.relaxation_per_s,
            horizon_us,
        }
    }
}

/// Upper triangle by rows of the symmetric part, (21).
fn pack_symmetric(matrix: &[[f32; 6]; 6]) -> [f32; 21] {
    let mut packed = [0.0; 21];
    let rows = matrix.iter().enumerate();
    let pairs = rows.flat_map(|(i, row)| {
        let column = matrix.iter().map(move |other| other.get(i));
        row.iter().zip(column).skip(i)
    });
    for (place, (above, below)) in packed.iter_mut().zip(pairs) {
        *place = 0.5 * (above + below.unwrap_or(above));
    }
    packed
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Symmetric part s(i, j) = 10 min + max (1-based), skew part i - j.
    #[test]
    fn the_symmetric_part_is_packed_row_by_row() {
        let mut tangent = [[0.0; 6]; 6];
        for (i, row) in tangent.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                let (low, high) = (i.min(j) + 1, i.max(j) + 1);
                *entry = (10 * low + high) as f32 + (i as f32 - j as f32);
            }
        }
        let expected = [
            11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 22.0, 23.0, 24.0, 25.0, 26.0, 33.0, 34.0, 35.0,
            36.0, 44.0, 45.0, 46.0, 55.0, 56.0, 66.0,
        ];
        assert_eq!(pack_symmetric(&tangent), expected);
    }

    #[test]
    fn a_plain_force_is_its_own_normal() {
        let contact = Contact::force([3.0, 0.0, -4.0]);
        assert_eq!(contact.normal, [0.6, 0.0, -0.8]);
        assert_eq!(Contact::force([0.0; 3]).normal, [0.0, 0.0, 1.0]);
    }
}
