//! No swept test misses what exact arithmetic finds.
//!
//! A million queries take minutes: `cargo test --release -p sutura-host --test all collide:: -- --ignored
//! --nocapture`. In every other run it is a hundredth of them.

use super::exact::{Exact, Kind, LARGEST, Query};
use super::queries::{Chance, FAMILIES, Family, draw};
use nalgebra::Vector3;
use sutura_host::collide::{Impact, Margin, Path, Sweep, Verdict, edge_edge, vertex_face};

/// One unit \[m\]: things are a metre in size.
const UNIT_M: f64 = 1.0 / (1u64 << 20) as f64;
/// What a box of 2^-40 leaves open is closer than this: its sides, in time and two places, are at most 8
/// sizes by axis.
const MARGIN: Margin = Margin {
    separation_m: 64.0 / (1u64 << 40) as f64,
    tolerance_m: 64.0 / (1u64 << 40) as f64,
};

/// Round-off alone.
const NONE: Margin = Margin {
    separation_m: 0.0,
    tolerance_m: 0.0,
};

fn sweep(query: &Query, margin: &Margin) -> Sweep {
    let paths: [Path; 4] = std::array::from_fn(|node| {
        let place = |point: [i128; 3]| {
            Vector3::from(point.map(|x| {
                assert!(x.abs() < LARGEST);
                x as f64 * UNIT_M
            }))
        };
        Path {
            from: place(query.from[node]),
            to: place(query.to[node]),
        }
    });
    let [a, b, c, d] = &paths;
    match query.kind {
        Kind::VertexFace => vertex_face(a, [b, c, d], margin),
        Kind::EdgeEdge => edge_edge([a, b], [c, d], margin),
    }
}

/// Distance of the two points that are said to meet, when they are said to \[m\].
fn between(query: &Query, impact: &Impact) -> f64 {
    let nodes = query.from.iter().zip(&query.to).zip(impact.weights);
    let difference = nodes.map(|((from, to), weight)| {
        // About the first node: nothing is lost to how far away all of it is.
        let place = |point: &[i128; 3]| {
            Vector3::from_fn(|axis, _| (point[axis] - query.from[0][axis]) as f64 * UNIT_M)
        };
        (place(from) + (place(to) - place(from)) * impact.time) * weight
    });
    difference.sum::<Vector3<f64>>().norm()
}

#[derive(Debug, Default)]
struct Tally {
    queries: u32,
    hits: u32,
    missed: u32,
    late: u32,
    false_alarms: u32,
    given_up: u32,
    undecided: u32,
    parts: u64,
    most_parts: u32,
    /// Said to meet more than a sixteenth of the step before they do.
    early: u32,
}

fn compare(family: Family, queries: u32, seed: u64) -> Tally {
    let mut chance = Chance::new(seed);
    let mut tally = Tally::default();
    for _ in 0..queries {
        let drawn = draw(&mut chance, family);
        let exact = drawn.query.decide();
        let found = sweep(&drawn.query, &MARGIN);
        tally.queries += 1;
        tally.parts += u64::from(found.parts);
        tally.most_parts = tally.most_parts.max(found.parts);
        let planted = drawn.meets_at.map(|sixteenths| sixteenths as f64 / 16.0);
        if let Some(planted) = planted {
            // What meets exactly meets without any margin, too: rounding is accounted for.
            let bare = sweep(&drawn.query, &NONE).verdict;
            if !matches!(bare, Verdict::Meet(impact) if impact.time <= planted) {
                tally.missed += 1;
                println!(
                    "{family:?} missed without a margin: {bare:?} {:?}",
                    drawn.query
                );
            }
            assert!(
                exact != Exact::Apart,
                "{family:?}: the oracle says {exact:?} of what was planted: {:?}",
                drawn.query
            );
        }
        // When it is known to meet, at the latest.
        let known = match (exact, planted) {
            (Exact::Hit(time), planted) => {
                let time = (time + 1) as f64 / (1u64 << 40) as f64;
                Some(planted.map_or(time, |planted| planted.min(time)))
            }
            (Exact::TooLong, Some(planted)) => Some(planted),
            (Exact::TooLong, None) => {
                tally.undecided += 1;
                continue;
            }
            (Exact::Apart, _) => None,
        };
        match (known, found.verdict) {
            (Some(known), Verdict::Meet(impact)) => {
                tally.hits += 1;
                tally.given_up += u32::from(impact.given_up);
                let apart_m = between(&drawn.query, &impact);
                assert!(
                    impact.given_up || apart_m <= 1.01 * (MARGIN.separation_m + MARGIN.tolerance_m),
                    "{family:?}: {apart_m:e} m apart, {found:?} of {:?}",
                    drawn.query
                );
                // That was some meeting, not the first: nothing meets before what was found, and something does
                // soon after.
                let before = (16.0 * impact.time).floor();
                let until = |sixteenths: f64| drawn.query.until(sixteenths as i128).decide();
                if impact.time > known || before > 0.0 && matches!(until(before), Exact::Hit(_)) {
                    tally.late += 1;
                    println!("{family:?} late: {found:?} {known} {:?}", drawn.query);
                }
                tally.early += u32::from(until((before + 1.0).min(16.0)) == Exact::Apart);
            }
            (Some(_), _) => {
                tally.missed += 1;
                println!("{family:?} missed: {found:?} {exact:?} {:?}", drawn.query);
            }
            (None, Verdict::Meet(impact)) => {
                tally.false_alarms += 1;
                tally.given_up += u32::from(impact.given_up);
            }
            (None, Verdict::Apart) => {}
            (None, Verdict::NotFinite) => panic!("{:?}", drawn.query),
        }
    }
    tally
}

fn all_families(queries: u32) {
    let each = queries / FAMILIES.len() as u32;
    let mut all = Tally::default();
    let tallies: Vec<Tally> = std::thread::scope(|scope| {
        let running: Vec<_> = (1..)
            .zip(FAMILIES)
            .map(|(seed, family)| scope.spawn(move || compare(family, each, seed)))
            .collect();
        let ended = running.into_iter().map(std::thread::ScopedJoinHandle::join);
        ended.map(|tally| tally.expect("a comparison")).collect()
    });
    for (family, tally) in FAMILIES.iter().zip(tallies) {
        println!(
            "{family:?}: {} of {} meet, {} missed, {} late, {} false alarms, {} given up, {} undecided; \
             {} early; {:.2} parts, at most {}",
            tally.hits,
            tally.queries,
            tally.missed,
            tally.late,
            tally.false_alarms,
            tally.given_up,
            tally.undecided,
            tally.early,
            tally.parts as f64 / f64::from(tally.queries),
            tally.most_parts,
        );
        all.queries += tally.queries;
        all.hits += tally.hits;
        all.missed += tally.missed;
        all.late += tally.late;
        all.false_alarms += tally.false_alarms;
        all.given_up += tally.given_up;
        all.undecided += tally.undecided;
        all.early += tally.early;
    }
    println!("{all:?}");
    assert_eq!((all.missed, all.late), (0, 0));
    assert!(all.undecided * 10_000 <= all.queries, "{all:?}");
    // The search is conservative, not timid.
    let timid = all.false_alarms + all.early + all.given_up;
    assert!(timid * 1000 <= all.queries, "{all:?}");
    assert!(all.hits * 2 > all.queries);
}

#[test]
fn no_swept_test_misses_what_exact_arithmetic_finds() {
    all_families(4_500);
}

#[test]
#[ignore = "a million queries: minutes in a debug build"]
fn no_swept_test_of_a_million_misses_what_exact_arithmetic_finds() {
    all_families(1_000_000 + FAMILIES.len() as u32);
}
