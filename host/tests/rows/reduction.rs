//! The reduction against finite differences of the solve itself.

use super::sets::Set;
use super::{GENTLE, cold, sets};
use sutura_host::rows::{Condensed, Method, Mode, RowKind, State, condense, tangent};
use sutura_testkit::Random;

/// A tool's rows: J in the rows' own magnitude.
fn jacobian(set: &Set, random: &mut Random) -> Vec<f64> {
    let n = set.rows.len();
    let own = |row: usize| set.compliance[row * (n + 1)].sqrt();
    (0..6 * n).map(|at| own(at % n) * random.signed()).collect()
}

/// Both sides of `set` along `direction`, if no row changes its mode between them.
fn both_sides(set: &Set, direction: &[f64], step: f64) -> Option<[State; 2]> {
    let modes = cold(set, Method::ActiveSet).1.modes().to_vec();
    let sides = [step, -step].map(|step| {
        let mut moved = set.clone();
        for (free, along) in moved.delta_free.iter_mut().zip(direction) {
            *free += step * along;
        }
        cold(&moved, Method::ActiveSet).1
    });
    sides
        .iter()
        .all(|side| side.modes() == modes)
        .then_some(sides)
}

/// Step of finite differences in units in which J has entries of about 1: a set without slip is
/// linear between its switches, a slip is not.
fn step(set: &Set, state: &State) -> f64 {
    let n = set.rows.len();
    let scaled = |row: usize| set.delta_free[row].abs() / set.compliance[row * (n + 1)].sqrt();
    let size = (0..n).map(scaled).fold(0.0, f64::max);
    let slips = state.modes().contains(&Mode::Slipping);
    size * if slips { 1e-5 } else { 1e-4 }
}

#[test]
fn the_tangent_is_the_derivative_of_the_wrench() {
    let mut random = Random::new(10);
    let (mut checked, mut slipping) = (0, 0);
    for set in sets(10, 400, GENTLE) {
        let n = set.rows.len();
        let j = jacobian(&set, &mut random);
        let (_, state, mut work) = cold(&set, Method::ActiveSet);
        let step = step(&set, &state);
        let reduction = tangent(&set.problem(), &state, &j, &mut work).expect("its own state");
        let mut difference = [[0.0; 6]; 6];
        let sides: Option<Vec<_>> = (0..6)
            .map(|axis| both_sides(&set, &j[n * axis..n * (axis + 1)], step))
            .collect();
        let Some(sides) = sides else { continue };
        for (axis, [ahead, behind]) in sides.iter().enumerate() {
            for (i, row) in difference.iter_mut().enumerate() {
                row[axis] = (0..n)
                    .map(|row| j[n * i + row] * (ahead.lambda()[row] - behind.lambda()[row]))
                    .sum::<f64>()
                    / (2.0 * step);
            }
        }
        let size = difference
            .as_flattened()
            .iter()
            .fold(0.0f64, |m, x| m.max(x.abs()));
        let slips = state.modes().contains(&Mode::Slipping);
        let tolerance = if slips { 1e-4 } else { 1e-6 } * size;
        let mut skew = 0.0f64;
        for (i, row) in difference.iter().enumerate() {
            for (k, entry) in row.iter().enumerate() {
                let symmetric = 0.5 * (entry + difference[k][i]);
                skew = skew.max(0.5 * (entry - difference[k][i]).abs());
                assert!(
                    (reduction.tangent[i][k] - symmetric).abs() <= tolerance,
                    "{} {symmetric} of {size}",
                    reduction.tangent[i][k]
                );
            }
        }
        assert!(
            (reduction.skew - skew).abs() <= tolerance,
            "{} {skew}",
            reduction.skew
        );
        checked += 1;
        slipping += usize::from(slips && skew > 1e-3 * size);
    }
    assert!(checked > 200 && slipping > 30, "{checked} {slipping}");
}

/// The kept rows' gaps when their forces are given and the others answer.
struct Answer {
    delta: Vec<f64>,
    modes: Vec<Mode>,
}

fn answer(set: &Set, keep: &[usize], forces: &[f64]) -> Answer {
    let n = set.rows.len();
    let others: Vec<usize> = (0..n).filter(|row| !keep.contains(row)).collect();
    let w = |row: usize, column: usize| set.compliance[column * n + row];
    let pushed = |row: usize| -> f64 {
        let push = keep.iter().zip(forces);
        set.delta_free[row] + push.map(|(&from, force)| w(row, from) * force).sum::<f64>()
    };
    let mut rest = set.clone();
    rest.rows = others.iter().map(|&row| set.rows[row]).collect();
    rest.delta_free = others.iter().map(|&row| pushed(row)).collect();
    rest.compliance = others
        .iter()
        .flat_map(|&column| others.iter().map(move |&row| w(row, column)))
        .collect();
    let (_, state, _) = cold(&rest, Method::ActiveSet);
    let delta = keep.iter().map(|&row| {
        let answered = others.iter().zip(state.lambda());
        pushed(row)
            + answered
                .map(|(&from, force)| w(row, from) * force)
                .sum::<f64>()
    });
    Answer {
        delta: delta.collect(),
        modes: state.modes().to_vec(),
    }
}

#[test]
fn condensed_rows_answer_like_the_whole_set() {
    let mut random = Random::new(11);
    let (mut checked, mut slipping) = (0, 0);
    for set in sets(11, 400, GENTLE) {
        let n = set.rows.len();
        let mut keep = Vec::new();
        for row in 0..n {
            match set.rows[row].kind {
                RowKind::Tangent => {}
                RowKind::Normal { .. } if random.chance(0.3) => keep.extend(row..row + 3),
                RowKind::Normal { .. } => {}
                _ if random.chance(0.2) => keep.push(row),
                _ => {}
            }
        }
        let k = keep.len();
        let j = jacobian(&set, &mut random);
        let (_, state, mut work) = cold(&set, Method::ActiveSet);
        let (mut compliance, mut free, mut jacobian) =
            (vec![0.0; k * k], vec![0.0; k], vec![0.0; 6 * k]);
        let mut out = Condensed {
            compliance: &mut compliance,
            delta_free: &mut free,
            jacobian: &mut jacobian,
        };
        let skew = condense(&set.problem(), &state, &keep, &j, &mut work, &mut out)
            .expect("its own state");
        let forces: Vec<f64> = keep.iter().map(|&row| state.lambda()[row]).collect();
        let own = |row: usize| set.compliance[row * (n + 1)].sqrt();
        let step = step(&set, &state);
        let base = answer(&set, &keep, &forces);
        let slips = base.modes.contains(&Mode::Slipping);
        let tolerance = if slips { 1e-4 } else { 1e-6 };

        // The same gaps at the present forces.
        for (i, &row) in keep.iter().enumerate() {
            let pushed: f64 = (0..k).map(|c| compliance[c * k + i] * forces[c]).sum();
            let off = (free[i] + pushed - state.delta()[row]).abs();
            assert!(off <= 1e-9 * own(row) * step / 1e-5, "{off}");
        }
        let mut full = vec![0.0; k * k];
        let mut same = true;
        for c in 0..k {
            let push = |side: f64| {
                let mut forces = forces.clone();
                forces[c] += side * step / own(keep[c]);
                answer(&set, &keep, &forces)
            };
            let (ahead, behind) = (push(1.0), push(-1.0));
            same &= ahead.modes == base.modes && behind.modes == base.modes;
            for i in 0..k {
                let rise = (ahead.delta[i] - behind.delta[i]) / (2.0 * step);
                full[c * k + i] = rise * own(keep[c]);
            }
        }
        let mut moved = vec![0.0; 6 * k];
        for axis in 0..6 {
            let push = |side: f64| {
                let mut set = set.clone();
                for (free, along) in set.delta_free.iter_mut().zip(&j[n * axis..]) {
                    *free += side * step * along;
                }
                answer(&set, &keep, &forces)
            };
            let (ahead, behind) = (push(1.0), push(-1.0));
            same &= ahead.modes == base.modes && behind.modes == base.modes;
            for i in 0..k {
                moved[axis * k + i] = (ahead.delta[i] - behind.delta[i]) / (2.0 * step);
            }
        }
        if !same || k == 0 || k == n {
            continue;
        }
        let largest = keep.iter().map(|&row| own(row)).fold(0.0, f64::max);
        for i in 0..k {
            for c in 0..k {
                let symmetric = 0.5 * (full[c * k + i] + full[i * k + c]);
                let off = (compliance[c * k + i] - symmetric).abs();
                assert!(off <= tolerance * largest * largest, "{off} {symmetric}");
                let apart = 0.5 * (full[c * k + i] - full[i * k + c]).abs();
                assert!(apart <= skew + tolerance * largest * largest);
            }
        }
        for (jacobian, moved) in jacobian.iter().zip(&moved) {
            assert!(
                (jacobian - moved).abs() <= tolerance * 10.0 * largest,
                "{jacobian} {moved}"
            );
        }
        checked += 1;
        slipping += usize::from(slips);
    }
    assert!(checked > 150 && slipping > 20, "{checked} {slipping}");
}
