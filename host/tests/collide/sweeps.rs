//! Swept tests whose outcome is known, with a separation, and at extremes.

use super::queries::{Chance, FAMILIES, draw};
use nalgebra::Vector3;
use sutura_host::collide::{Impact, Margin, Path, Verdict, edge_edge, vertex_face};

const CLOSE: Margin = Margin {
    separation_m: 0.0,
    tolerance_m: 1e-12,
};

fn still(x: f64, y: f64, z: f64) -> Path {
    let at = Vector3::new(x, y, z);
    Path { from: at, to: at }
}

fn moving(from: [f64; 3], to: [f64; 3]) -> Path {
    Path {
        from: from.into(),
        to: to.into(),
    }
}

fn impact(verdict: Verdict) -> Impact {
    let Verdict::Meet(impact) = verdict else {
        panic!("{verdict:?}");
    };
    assert!(!impact.given_up);
    impact
}

/// Falling 3 mm in a step, at the height of 1 mm: a third; a separation of 0.4 mm is reached at a fifth.
#[test]
fn a_falling_vertex_meets_a_face_where_and_when_it_should() {
    let face = [
        still(0.0, 0.0, 0.0),
        still(0.01, 0.0, 0.0),
        still(0.0, 0.01, 0.0),
    ];
    let vertex = moving([0.002, 0.005, 0.001], [0.002, 0.005, -0.002]);
    let [a, b, c] = &face;
    let fall = |margin| impact(vertex_face(&vertex, [a, b, c], margin).verdict);
    let found = fall(&CLOSE);
    assert!((found.time - 1.0 / 3.0).abs() < 1e-8, "{found:?}");
    for (weight, expected) in found.weights.iter().zip([1.0, -0.3, -0.2, -0.5]) {
        assert!((weight - expected).abs() < 1e-6, "{found:?}");
    }
    let wide = Margin {
        separation_m: 4e-4,
        ..CLOSE
    };
    let found = fall(&wide);
    assert!((found.time - 0.2).abs() < 1e-8, "{found:?}");
    // Past the face by more than the separation, and by less.
    for (x, expected) in [(-5e-4, false), (-3e-4, true)] {
        let aside = moving([x, 0.005, 0.001], [x, 0.005, -0.002]);
        let verdict = vertex_face(&aside, [a, b, c], &wide).verdict;
        assert_eq!(verdict != Verdict::Apart, expected, "{x}: {verdict:?}");
    }
}

/// Two edges that cross as an X, the upper one turning about its middle while it sinks.
#[test]
fn a_sinking_edge_meets_another_at_their_middles() {
    let lower = [still(-0.01, 0.0, 0.0), still(0.01, 0.0, 0.0)];
    let upper = [
        moving([0.0, -0.01, 0.001], [0.01, -0.01, -0.001]),
        moving([0.0, 0.01, 0.001], [-0.01, 0.01, -0.001]),
    ];
    let [a, b] = &lower;
    let [c, d] = &upper;
    let found = impact(edge_edge([a, b], [c, d], &CLOSE).verdict);
    assert!((found.time - 0.5).abs() < 1e-8, "{found:?}");
    for (weight, expected) in found.weights.iter().zip([0.5, 0.5, -0.5, -0.5]) {
        assert!((weight - expected).abs() < 1e-6, "{found:?}");
    }
}

/// Whatever two points come closer than the separation at some time, that is said, and not later. Points
/// and times are samples; exact bisection knows no separation.
#[test]
fn nothing_comes_closer_than_the_separation_unsaid() {
    const PARTS: u32 = 12;
    let part = |k: u32| f64::from(k) / f64::from(PARTS);
    let mut chance = Chance::new(5);
    let (mut meeting, mut apart) = (0, 0);
    for number in 0..1500 {
        let query = draw(&mut chance, FAMILIES[number % FAMILIES.len()]).query;
        let unit = 1.0 / (1u64 << 20) as f64;
        let place = |point: [i128; 3]| Vector3::from(point.map(|x| x as f64 * unit));
        let paths: [Path; 4] = std::array::from_fn(|node| Path {
            from: place(query.from[node]),
            to: place(query.to[node]),
        });
        let [a, b, c, d] = &paths;
        let margin = Margin {
            separation_m: 0.1,
            tolerance_m: 1e-4,
        };
        let is_face = number % 2 == 0;
        let verdict = if is_face {
            vertex_face(a, [b, c, d], &margin).verdict
        } else {
            edge_edge([a, b], [c, d], &margin).verdict
        };
        let time = match verdict {
            Verdict::Meet(impact) => impact.time,
            _ => f64::INFINITY,
        };
        let mut closest = f64::INFINITY;
        for k in (0..=4 * PARTS).filter(|k| 0.25 * part(*k) < time) {
            let at = paths.map(|path| path.from + (path.to - path.from) * (0.25 * part(k)));
            for (u, v) in (0..=PARTS).flat_map(|u| (0..=PARTS).map(move |v| (part(u), part(v)))) {
                let difference = if is_face {
                    let (u, v) = (u * (1.0 - v), v);
                    at[0] - at[1] * (1.0 - u - v) - at[2] * u - at[3] * v
                } else {
                    at[0] * (1.0 - u) + at[1] * u - at[2] * (1.0 - v) - at[3] * v
                };
                closest = closest.min(difference.norm());
            }
        }
        assert!(
            closest >= margin.separation_m,
            "{closest} m apart before {time}: {query:?}"
        );
        if time.is_finite() {
            meeting += 1;
        } else {
            apart += 1;
        }
    }
    assert!(
        meeting > 100 && apart > 100,
        "{meeting} meet, {apart} do not"
    );
}

/// From sizes of an atom to those of a galaxy the answer is the same; what is no number is refused.
#[test]
fn sizes_do_not_matter_and_what_is_no_number_is_refused() {
    let at = |scale: f64, z: f64| {
        let face = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
            .map(|[x, y, z]| still(scale * x, scale * y, scale * z));
        let vertex = moving(
            [0.25 * scale, 0.25 * scale, scale],
            [0.25 * scale, 0.25 * scale, z],
        );
        let margin = Margin {
            separation_m: 0.0,
            tolerance_m: 1e-9 * scale,
        };
        let [a, b, c] = &face;
        vertex_face(&vertex, [a, b, c], &margin).verdict
    };
    for scale in [1e-100, 1e-10, 1.0, 1e20, 1e59] {
        let found = impact(at(scale, -scale));
        assert!((found.time - 0.5).abs() < 1e-8, "{scale}: {found:?}");
        assert_eq!(at(scale, 0.01 * scale), Verdict::Apart);
    }
    for z in [f64::NAN, f64::INFINITY, -1e61] {
        assert_eq!(at(1.0, z), Verdict::NotFinite);
    }
    let [a, b, c, d] = [0.0, 1.0, 2.0, 3.0].map(|x| still(x, 0.0, 0.0));
    // Wherever it is.
    for node in 0..4 {
        let mut paths = [a, b, c, d];
        paths[node].to.y = f64::NAN;
        let [a, b, c, d] = &paths;
        assert_eq!(
            vertex_face(a, [b, c, d], &CLOSE).verdict,
            Verdict::NotFinite
        );
        assert_eq!(
            edge_edge([a, b], [c, d], &CLOSE).verdict,
            Verdict::NotFinite
        );
    }
    for bad in [f64::NAN, -1e-9] {
        let margin = Margin {
            separation_m: bad,
            ..CLOSE
        };
        let verdict = edge_edge([&a, &b], [&c, &d], &margin).verdict;
        assert_eq!(verdict, Verdict::NotFinite);
    }
}

#[test]
fn a_swept_test_allocates_nothing() {
    let mut chance = Chance::new(9);
    let queries: Vec<[Path; 4]> = (0..200)
        .map(|number| {
            let query = draw(&mut chance, FAMILIES[number % FAMILIES.len()]).query;
            let place = |point: [i128; 3]| Vector3::from(point.map(|x| x as f64));
            std::array::from_fn(|node| Path {
                from: place(query.from[node]),
                to: place(query.to[node]),
            })
        })
        .collect();
    let mut halved = 0;
    let allocated = allocation_counter::measure(|| {
        for [a, b, c, d] in &queries {
            let found = [
                vertex_face(a, [b, c, d], &CLOSE),
                edge_edge([a, b], [c, d], &CLOSE),
            ];
            halved += found.iter().filter(|sweep| sweep.parts > 1).count();
        }
    });
    assert_eq!(allocated.count_total, 0, "{allocated:?}");
    assert!(halved > 20, "only {halved} were halved");
}
