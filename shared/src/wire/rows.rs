//! What a console accepts of contact rows.

use super::frame::Kind;
use super::message::{MAX_ROWS, Row, RowKind, Rows};
use super::reject::Reject;
use super::validate::{
    MAX_CURVATURE, MAX_POSITION, MAX_TANGENT, MAX_TOOLS, MAX_WRENCH, Message, between, require,
    within,
};

/// Largest compliance \[m/N\]: softer than any tissue, and a row that hardly bears anything.
pub const MAX_COMPLIANCE: f32 = 1e4;
/// Least compliance of a row under its own force \[m/N\]: see [`MAX_TANGENT`].
pub const MIN_COMPLIANCE: f32 = 1.0 / MAX_TANGENT;
/// Largest entry of a row's Jacobian \[m/m, m/rad\]: a unit vector, its arm, and a hundredfold for what turns.
pub const MAX_JACOBIAN: f32 = 100.0 * MAX_POSITION;
/// Coulomb's coefficient: from what is no friction to what nothing has.
pub const FRICTION: [f32; 2] = [1e-6, 10.0];
/// By how much the square of an entry of W may exceed the product of its two diagonals: rounding to f32.
const ROUNDING: f32 = 1.0 + 1e-5;

impl Message for Rows {
    const KIND: Kind = Kind::Rows;

    /// A compliance that passes may still not be positive definite: whoever solves it bounds the multipliers.
    fn check(&self) -> Result<(), Reject> {
        require(self.tool < MAX_TOOLS)?;
        within(&self.held, MAX_TANGENT)?;
        between(self.curvature_per_m, 0.0, MAX_CURVATURE)?;
        let rows = self.rows.items();
        for row in rows {
            within(&[row.delta_free_m], MAX_POSITION)?;
            within(&[row.lambda_n], MAX_WRENCH)?;
            within(&row.jacobian, MAX_JACOBIAN)?;
        }
        check_order(rows)?;
        check_compliance(rows.len(), self.compliance.items())
    }
}

/// Tangents come in pairs behind their normal; no contact comes twice.
fn check_order(rows: &[Row]) -> Result<(), Reject> {
    let mut rest = rows;
    while let Some((row, behind)) = rest.split_first() {
        let (id, tangents) = match row.kind {
            RowKind::Smooth { id } => (id, 0),
            RowKind::Normal { id, friction } => {
                let [low, high] = FRICTION;
                between(friction, low, high)?;
                (id, 2)
            }
            RowKind::Tangent { .. } => return Err(Reject::Range),
        };
        require(row.lambda_n >= 0.0)?;
        let (pair, others) = behind.split_at_checked(tangents).ok_or(Reject::Range)?;
        for tangent in pair {
            let RowKind::Tangent { anchor_m } = tangent.kind else {
                return Err(Reject::Range);
            };
            within(&[anchor_m], MAX_POSITION)?;
        }
        require(others.iter().all(|other| contact_id(other) != Some(id)))?;
        rest = others;
    }
    Ok(())
}

/// Of a contact's first row.
fn contact_id(row: &Row) -> Option<u32> {
    match row.kind {
        RowKind::Smooth { id } | RowKind::Normal { id, .. } => Some(id),
        RowKind::Tangent { .. } => None,
    }
}

/// As many entries as `count` rows have, positive diagonals, and no coupling stronger than they allow.
fn check_compliance(count: usize, packed: &[f32]) -> Result<(), Reject> {
    require(packed.len() == count * (count + 1) / 2)?;
    within(packed, MAX_COMPLIANCE)?;
    let mut diagonals = [0.0; MAX_ROWS];
    let mut rest = packed;
    for (index, diagonal) in diagonals.iter_mut().take(count).enumerate() {
        let (row, others) = rest.split_at_checked(count - index).ok_or(Reject::Range)?;
        *diagonal = row.first().copied().unwrap_or_default();
        require(*diagonal >= MIN_COMPLIANCE)?;
        rest = others;
    }
    rest = packed;
    for index in 0..count {
        let (row, others) = rest.split_at_checked(count - index).ok_or(Reject::Range)?;
        let of_columns = diagonals.iter().skip(index);
        let own = row.first().copied().unwrap_or_default() * ROUNDING;
        let sound = |(entry, of_column): (&f32, &f32)| entry * entry <= own * of_column;
        require(row.iter().zip(of_columns).all(sound))?;
        rest = others;
    }
    Ok(())
}
