//! The solver's contact as the wire carries it: f32, and the tangent as the 21 entries of its symmetric part.
//!
//! Entry point: [`contact_frame`]. The console rebuilds the skew part of the tangent from the moment
//! (dF/dq of a loaded contact is not symmetric; its skew part is -1/2 \[m\]x in the rotation block).

use crate::step::ToolContact;
use sutura_shared::wire::message::{Contact, State};
use sutura_shared::wire::validate::{MAX_POSITION, MAX_RELAXATION};

/// Number on the wire of the tool that the console's grip carries, whatever its id in the scene.
pub(super) const GRIP: u8 = 0;

/// Upper triangle by rows of the symmetric part of `tangent`, (21).
pub fn pack_symmetric(tangent: &[[f64; 6]; 6]) -> [f32; 21] {
    let mut packed = [0.0; 21];
    let pairs = (0..6).flat_map(|row| (row..6).map(move |column| (row, column)));
    for (entry, (row, column)) in packed.iter_mut().zip(pairs) {
        *entry = (0.5 * (tangent[row][column] + tangent[column][row])) as f32;
    }
    packed
}

/// The contact frame for the state that `contact` was solved for, good until `horizon_us` after it.
pub fn contact_frame(state: &State, contact: &ToolContact, horizon_us: u32) -> Contact {
    Contact {
        tool: GRIP,
        // As it came: the console extrapolates from exactly this pose.
        position_m: state.position_m,
        orientation: state.orientation,
        wrench: contact.wrench.map(|value| value as f32),
        tangent: pack_symmetric(&contact.tangent),
        // The wire has no negative gap (a penetration is part of the solved force), and none that is longer than any
        // console reaches.
        gap_m: contact.gap_m.clamp(0.0, f64::from(MAX_POSITION)) as f32,
        normal: contact.normal.map(|value| value as f32),
        relaxation_per_s: contact.relaxation_per_s.min(f64::from(MAX_RELAXATION)) as f32,
        horizon_us,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sutura_shared::wire::Message;
    use sutura_shared::wire::message::Mode;

    #[test]
    fn packing_keeps_the_symmetric_part_in_the_order_of_the_rows() {
        // Symmetric part s(i, j) = 10 min + max (1-based), skew part i - j.
        let mut tangent = [[0.0; 6]; 6];
        for (i, row) in tangent.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                let (low, high) = (i.min(j) + 1, i.max(j) + 1);
                *entry = (10 * low + high) as f64 + (i as f64 - j as f64);
            }
        }
        let expected = [
            11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 22.0, 23.0, 24.0, 25.0, 26.0, 33.0, 34.0, 35.0,
            36.0, 44.0, 45.0, 46.0, 55.0, 56.0, 66.0,
        ];
        assert_eq!(pack_symmetric(&tangent), expected);
    }

    /// The quadratic form of the packed entries is that of the whole matrix: what a spring stores.
    #[test]
    fn the_energy_of_any_displacement_survives_packing() {
        let tangent: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| ((7 * i + 13 * j * j) % 17) as f64 - 8.0)
        });
        let dx: [f64; 6] = [1.0, -2.0, 0.5, 3.0, -1.5, 0.25];
        let full: f64 = (0..6)
            .flat_map(|i| (0..6).map(move |j| (i, j)))
            .map(|(i, j)| dx[i] * tangent[i][j] * dx[j])
            .sum();
        let packed = pack_symmetric(&tangent);
        let mut sum = 0.0;
        let mut k = 0;
        for i in 0..6 {
            for j in i..6 {
                sum += if i == j { 1.0 } else { 2.0 } * dx[i] * f64::from(packed[k]) * dx[j];
                k += 1;
            }
        }
        // All entries are halves of small integers: exact in f32.
        assert_eq!(sum, full);
    }

    #[test]
    fn the_frame_passes_the_consoles_own_check() {
        let state = State {
            tick: 1,
            position_m: [0.1, -0.2, 0.3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            velocity_m_per_s: [0.0; 3],
            force_n: [0.0; 3],
            current_a: [0.0; 3],
            mode: Mode::Armed,
            faults: 0,
            contact_sequence: 0,
            contact_age_us: 0,
            applied_age_us: 0,
            trace_hash: 0,
            encoder_counts: [0; 3],
            inputs: 0,
            heard_sequence: 0,
        };
        let third = 1.0 / 3.0_f64.sqrt();
        let contact = ToolContact {
            id: 0,
            wrench: [0.0, 0.0, 2.0, 0.0, 0.0, 0.0],
            tangent: [[-1.0; 6]; 6],
            gap_m: -1e-9,
            normal: [third; 3],
            rows: 5,
            relaxation_per_s: 2e3,
        };
        let frame = contact_frame(&state, &contact, 50_000);
        assert_eq!(frame.check(), Ok(()));
        assert_eq!(frame.position_m, state.position_m);
        assert_eq!((frame.gap_m, frame.horizon_us), (0.0, 50_000));
        assert_eq!(frame.relaxation_per_s, MAX_RELAXATION);
        // A grip whose needle another tool has taken touches nothing anywhere.
        let nowhere = ToolContact {
            gap_m: f64::MAX,
            ..contact
        };
        let frame = contact_frame(&state, &nowhere, 50_000);
        assert_eq!((frame.check(), frame.gap_m), (Ok(()), MAX_POSITION));
    }
}
