//! Random pieces against the law itself, and cases by hand.

use super::*;

struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In 0 to 1.
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }

    fn below(&mut self, most: usize) -> usize {
        (self.bits() % most as u64) as usize
    }
}

struct Set {
    compliance: Vec<f64>,
    free: Vec<f64>,
    available_m: f64,
    limit_n: f64,
}

/// Pieces between points of something soft, of any rank, with pieces that are the same, fixed or closed.
fn set(random: &mut Random) -> Set {
    let count = 1 + random.below(12);
    let n = 3 * count;
    let rank = 1 + random.below(2 * n);
    let mut ways: Vec<f64> = (0..n * rank).map(|_| random.signed()).collect();
    let decades = 4.0 * random.unit();
    for mode in ways.chunks_exact_mut(n) {
        let size = 10f64.powf(-decades * random.unit());
        mode.iter_mut().for_each(|x| *x *= size);
    }
    let mut free: Vec<f64> = (0..n).map(|_| 0.01 * random.signed()).collect();
    for piece in 0..count {
        let kind = random.below(12);
        let from = random.below(count);
        for axis in 0..3 {
            let at = 3 * piece + axis;
            for mode in ways.chunks_exact_mut(n) {
                match kind {
                    0 => mode[at] = 0.0,
                    1 => mode[at] = mode[3 * from + axis],
                    2 => mode[at] = -mode[3 * from + axis],
                    _ => {}
                }
            }
            match kind {
                1 => free[at] = free[3 * from + axis],
                3 => free[at] = 0.0,
                4 => free[at] *= 1e-6,
                _ => {}
            }
        }
    }
    let softness = 10f64.powf(-3.0 + 4.0 * random.unit());
    let mut compliance = vec![0.0; n * n];
    for mode in ways.chunks_exact(n) {
        for (j, column) in compliance.chunks_exact_mut(n).enumerate() {
            for (g, x) in column.iter_mut().zip(mode) {
                *g += softness * x * mode[j] / rank as f64;
            }
        }
    }
    let share = match random.below(5) {
        0 => 0.0,
        1 => 0.999,
        2 => 0.1 * random.unit(),
        _ => random.unit(),
    };
    Set {
        available_m: share * total(&free),
        limit_n: 10f64.powf(-2.0 + 4.0 * random.unit()),
        compliance,
        free,
    }
}

/// How far a solution is from the law, in lengths; forces as what they move.
fn missed(set: &Set, tension: &Tension, end: End) -> f64 {
    let extent = (total(&set.free) + set.available_m).max(SHORTEST_M);
    let t = tension.tension_n();
    let force_scale = extent / tension.c;
    let mut worst = 0.0f64;
    // y is what the forces leave.
    let n = set.free.len();
    for row in 0..n {
        let column = &set.compliance[n * row..n * (row + 1)];
        let moved = dot(column, tension.force_n());
        worst = worst.max((set.free[row] - moved - tension.way_m()[row]).abs() / extent);
    }
    for (way, force) in tension.way_m().chunks(3).zip(tension.force_n().chunks(3)) {
        worst = worst.max((norm(force) - t) / force_scale);
        // T |y| - f . y is not negative and 0 for a piece that pulls along itself.
        worst = worst.max((t * norm(way) - dot(force, way)) / (force_scale.max(t) * extent));
    }
    let over = (tension.length_m() - set.available_m) / extent;
    match end {
        End::Solved if t > 0.0 => worst.max(over.abs()),
        End::Limit => worst.max(-over).max((t / set.limit_n - 1.0).abs()),
        _ => worst.max(over),
    }
}

#[test]
fn random_pieces_obey_the_law_whatever_they_are() {
    let mut random = Random(1);
    let mut tension = Tension::new(12);
    let (mut most, mut sum, mut slow, mut welds, mut limits, mut given_up) = (0, 0, 0, 0, 0, 0);
    const COUNT: u32 = 20_000;
    for index in 0..COUNT {
        let set = set(&mut random);
        if random.below(2) == 0 {
            tension.clear();
        }
        let (end, solves) = tension.solve(&set.compliance, &set.free, set.available_m, set.limit_n);
        if end == End::NotConverged {
            let bound = set.limit_n * (1.0 + 1e-9);
            assert!(tension.force_n().chunks(3).all(|f| norm(f) <= bound));
            given_up += 1;
            continue;
        }
        assert!(matches!(end, End::Solved | End::Limit), "{index}: {end:?}");
        let missed = missed(&set, &tension, end);
        assert!(
            missed <= 1e-8,
            "{index}: {missed:e} after {solves} solves, {end:?}"
        );
        most = most.max(solves);
        sum += solves;
        slow += u32::from(solves > NEWTON_STEPS);
        limits += u32::from(end == End::Limit);
        welds += tension
            .pieces()
            .iter()
            .filter(|p| **p == Piece::Weld)
            .count();
    }
    println!(
        "{} solves a set, most {most}, {slow} above {NEWTON_STEPS}; {welds} welds, {limits} at the limit, {given_up} \
         given up",
        f64::from(sum) / f64::from(COUNT)
    );
    // Of those that are dependent, asked for what they cannot do, and softer than their limit by 1e5.
    assert!(given_up <= COUNT / 500, "{given_up}");
    assert!(limits > 500 && welds > 5000 && slow > 10);
}

#[test]
fn garbage_gives_a_status_and_finite_forces() {
    let mut random = Random(2);
    let mut tension = Tension::new(12);
    for _ in 0..5_000 {
        let mut set = set(&mut random);
        let bad = [f64::NAN, f64::INFINITY, -1.0, 1e300, -1e300, 1e-300][random.below(6)];
        match random.below(4) {
            0 => {
                let at = random.below(set.compliance.len());
                set.compliance[at] = bad;
            }
            1 => {
                let at = random.below(set.free.len());
                set.free[at] = bad;
            }
            2 => set.available_m = bad,
            _ => set.limit_n = bad,
        }
        let (end, _) = tension.solve(&set.compliance, &set.free, set.available_m, set.limit_n);
        let forces = tension.force_n();
        assert!(tension.tension_n().is_finite() && forces.iter().all(|f| f.is_finite()));
        if end == End::Malformed {
            assert!(forces.is_empty() && tension.tension_n() == 0.0);
        } else {
            let bound = tension.tension_n() * (1.0 + 1e-6);
            assert!(tension.tension_n() <= set.limit_n * (1.0 + 1e-9));
            let bound = if end == End::NotConverged {
                set.limit_n * (1.0 + 1e-6)
            } else {
                bound
            };
            assert!(forces.chunks(3).all(|f| norm(f) <= bound), "{end:?}");
        }
    }
}

/// One piece, 4 m/N along itself: T = (1 - a) / 4.
#[test]
fn one_piece_is_a_spring() {
    let mut tension = Tension::new(1);
    let compliance = [4.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    for (available, expected) in [(1.5, 0.0), (1.0, 0.0), (0.6, 0.1), (0.0, 0.25)] {
        let (end, _) = tension.solve(&compliance, &[1.0, 0.0, 0.0], available, 10.0);
        assert_eq!(end, End::Solved);
        assert!((tension.tension_n() - expected).abs() < 1e-12);
        assert!((tension.force_n()[0] - expected).abs() < 1e-12);
    }
    let (end, _) = tension.solve(&compliance, &[1.0, 0.0, 0.0], 0.0, 0.1);
    assert_eq!(end, End::Limit);
    assert!((tension.length_m() - 0.6).abs() < 1e-12);
}
