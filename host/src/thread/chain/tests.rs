//! Chains against strings and beams of the books, and extremes.

use super::*;
use crate::mesh::tube;

fn vector(x: f64, y: f64, z: f64) -> Vector3<f64> {
    Vector3::new(x, y, z)
}

fn guide(along_m: f64, at_m: [f64; 3]) -> Guide {
    Guide { along_m, at_m }
}

/// Steps until the chain is at rest.
fn settle(chain: &mut Chain, dt: f64, guides: &[Guide]) {
    for _ in 0..2000 {
        let before = chain.nodes_m().to_vec();
        let report = chain.step(dt, guides, None);
        let sound = report.status != ChainStatus::Malformed && report.length_error < 1e-4;
        assert!(sound, "{report:?}");
        let moved = before
            .iter()
            .zip(chain.nodes_m())
            .map(|(a, b)| a.metric_distance(b));
        if moved.fold(0.0, f64::max) < 1e-9 {
            return;
        }
    }
    panic!("not at rest");
}

fn length(nodes: &[Vector3<f64>]) -> f64 {
    nodes
        .windows(2)
        .map(|ends| ends[0].metric_distance(&ends[1]))
        .sum()
}

/// The catenary: with c from 2 c sinh(span / 2 c) = length, sag c (cosh(span / 2 c) - 1), tension at the ends
/// w c cosh(span / 2 c).
#[test]
fn between_two_ends_it_hangs_as_a_catenary() {
    for (span, total) in [(0.3, 0.4), (0.1, 0.4), (0.39, 0.4)] {
        let mut settings = ChainSettings::of_length(total);
        settings.bending_n_m2 = 0.0;
        settings.nodes = 61;
        let (mut low, mut high) = (1e-3f64, 10.0f64);
        for _ in 0..200 {
            let c: f64 = 0.5 * (low + high);
            if 2.0 * c * (0.5 * span / c).sinh() > total {
                low = c
            } else {
                high = c
            }
        }
        let weight = settings.kg_per_m * 9.81;
        let sag = low * ((0.5 * span / low).cosh() - 1.0);
        let tension = weight * low * (0.5 * span / low).cosh();
        let across = weight * low;
        let mut chain =
            Chain::new(settings, &vector(0.0, 0.0, 0.0), &Vector3::x()).expect("a chain");
        // From far away: the end comes in from where the chain is straight.
        let guides = [guide(0.0, [0.0; 3]), guide(total, [span, 0.0, 0.0])];
        settle(&mut chain, 0.05, &guides);
        let lowest = chain.nodes_m().iter().map(|p| -p.z).fold(0.0, f64::max);
        assert!((lowest / sag - 1.0).abs() < 0.01, "{lowest} of {sag}");
        for (index, way) in [(0, 1.0), (1, -1.0)] {
            let pull = chain.pull_n(index);
            assert!(
                (pull.norm() / tension - 1.0).abs() < 0.01,
                "{pull:?} of {tension}"
            );
            assert!((way * pull.x / across - 1.0).abs() < 0.01);
            assert!((pull.z + 0.5 * weight * total).abs() < 1e-3 * weight * total);
        }
        assert!((length(chain.nodes_m()) / total - 1.0).abs() < 1e-9);
    }
}

/// One end held: the whole weight hangs there, whatever the period, and the second guide of a clamp.
#[test]
fn a_cantilever_bends_as_a_beam() {
    // Little weight: deflection q L^4 / 8 EI.
    let total = 0.02;
    let mut off = Vec::new();
    for nodes in [11, 21, 41] {
        let mut settings = ChainSettings::of_length(total);
        settings.nodes = nodes;
        let weight = settings.kg_per_m * 9.81;
        // Two guides one behind the other hold a direction.
        let segment = total / (nodes - 1) as f64;
        let guides = [guide(0.0, [0.0; 3]), guide(segment, [segment, 0.0, 0.0])];
        let mut chain = Chain::new(settings, &Vector3::zeros(), &Vector3::x()).expect("a chain");
        settle(&mut chain, 1.0, &guides);
        // Where the line begins to bend.
        let free = total - 0.5 * segment;
        let expected = weight * free.powi(4) / (8.0 * settings.bending_n_m2);
        let found = -chain.nodes_m()[nodes - 1].z;
        off.push((found / expected - 1.0).abs());
        let pull = chain.pull_n(0) + chain.pull_n(1);
        assert!((pull.z + weight * total).abs() < 1e-3 * weight * total);
    }
    assert!(off[2] < 0.002 && off[2] < 0.4 * off[1], "{off:?}");
}

/// A long strip held upright and let go is the elastica under its own weight; against shooting.
#[test]
fn a_heavy_cantilever_is_the_heavy_elastica() {
    let total = 0.15;
    let mut settings = ChainSettings::of_length(total);
    settings.nodes = 121;
    settings.bending_n_m2 = 1e-7;
    let weight = settings.kg_per_m * 9.81;
    let segment = total / 120.0;
    // Between two guides the clamp is where the line begins to bend.
    let free = total - 0.5 * segment;
    // EI theta'' = -w (L - s) cos(theta) with theta(0) = 0, theta'(L) = 0, theta downwards.
    let shoot = |slope: f64| {
        let (mut theta, mut rate, mut x, mut z) = (0.0f64, slope, 0.0, 0.0);
        let steps = 20_000;
        let h = free / f64::from(steps);
        for step in 0..steps {
            let s = (f64::from(step) + 0.5) * h;
            let middle = theta + 0.5 * h * rate;
            rate -= h * weight * (free - s) * middle.cos() / settings.bending_n_m2;
            theta = middle + 0.5 * h * rate;
            x += h * middle.cos();
            z -= h * middle.sin();
        }
        (rate, x, z)
    };
    let (mut low, mut high) = (0.0, 1000.0);
    for _ in 0..100 {
        let slope = 0.5 * (low + high);
        if shoot(slope).0 > 0.0 {
            high = slope
        } else {
            low = slope
        }
    }
    let (_, x, z) = shoot(low);
    let guides = [
        guide(0.0, [-0.5 * segment, 0.0, 0.0]),
        guide(segment, [0.5 * segment, 0.0, 0.0]),
    ];
    let mut chain =
        Chain::new(settings, &vector(-0.5 * segment, 0.0, 0.0), &Vector3::x()).expect("a chain");
    settle(&mut chain, 0.02, &guides);
    let end = chain.nodes_m()[120];
    assert!(
        (end - vector(x, 0.0, z)).norm() < 1e-3 * total,
        "{end:?} of {x} {z}"
    );
}

/// Over a lying cylinder, held at one end: no node inside on the way there, and at rest a tension that falls with height only,
/// T = w (z - z of the free end), as of a string over anything smooth.
#[test]
fn draped_over_a_cylinder_no_node_is_inside() {
    let mesh = tube([0.008, 0.011], [0.0, 0.03], [2, 30, 8]).expect("a tube");
    let place = |p: &[f64; 3]| vector(p[0], p[2] - 0.015, p[1]);
    let at: Vec<Vector3<f64>> = mesh.points_m().iter().map(place).collect();
    // Two axes are swapped, and with them inside and outside.
    let faces = mesh.surface().triangles;
    let faces: Vec<_> = faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    let skin = Skin::new(&faces, &at);
    let total = 0.12;
    for (bending, dt) in [(0.0, 4e-3), (2e-8, 1e-2), (0.0, 0.1)] {
        let mut settings = ChainSettings::of_length(total);
        settings.nodes = 61;
        settings.bending_n_m2 = bending;
        let start = vector(-0.03, 0.001, 0.013);
        let mut chain = Chain::new(settings, &start, &Vector3::x()).expect("a chain");
        let (mut deepest, mut touching, mut pull) = (f64::INFINITY, 0, Vector3::zeros());
        for step in 0..(3.0 / dt) as u32 {
            let share = (f64::from(step) * dt).min(1.0);
            let end = start + vector(0.016, 0.0, -0.025) * share;
            let report = chain.step(dt, &[guide(0.0, end.into())], Some((&skin, &at)));
            (touching, pull) = (report.touching, chain.pull_n(0));
            assert!(report.length_error < 1e-4, "{step} {report:?}");
            for node in chain.nodes_m() {
                if let Some((distance, _)) = skin.distance(&at, node, 1.0) {
                    deepest = deepest.min(distance);
                }
            }
        }
        assert!(deepest > 0.0, "{deepest} m");
        let height = chain.nodes_m()[0].z - chain.nodes_m()[60].z;
        let expected = settings.kg_per_m * 9.81 * height;
        assert!(touching > if bending > 0.0 { 1 } else { 4 }, "{touching}");
        assert!(height > 0.01);
        assert!(
            bending > 0.0 || (pull.norm() / expected - 1.0).abs() < 0.03,
            "{pull:?} of {expected}"
        );
    }
}

/// Kinetic, potential and bending energy, of a chain with a guide in its first node.
fn energy(chain: &Chain) -> f64 {
    let settings = &chain.settings;
    let segment = settings.length_m / (settings.nodes - 1) as f64;
    let last = settings.nodes - 1;
    let mut sum = 0.0;
    for (node, (at, velocity)) in chain
        .nodes
        .iter()
        .zip(&chain.velocities)
        .enumerate()
        .skip(1)
    {
        let mass = settings.kg_per_m * segment * if node == last { 0.5 } else { 1.0 };
        sum += mass * (0.5 * velocity.norm_squared() + 9.81 * at.z);
    }
    for three in chain.nodes.windows(3) {
        let kink = three[0] - three[1] * 2.0 + three[2];
        sum += 0.5 * settings.bending_n_m2 * kink.norm_squared() / segment.powi(3);
    }
    sum
}

/// Any period and any stiffness: finite, of its length, and once it is left alone never with more energy than it had.
#[test]
fn it_is_stable_for_any_period_and_stiffness() {
    let total = 0.2;
    for (dt, bending) in [1e-9, 1e-5, 1e-3, 0.1, 10.0, 1e6]
        .into_iter()
        .flat_map(|dt| [0.0, 1e-12, 1e-7, 1e-3, 1e3].map(|bending| (dt, bending)))
    {
        let mut settings = ChainSettings::of_length(total);
        settings.nodes = 31;
        settings.bending_n_m2 = bending;
        settings.drag_per_s = 0.0;
        let way = vector(1.0, 0.2, 0.3).normalize();
        let mut chain = Chain::new(settings, &Vector3::zeros(), &way).expect("a chain");
        let held = [guide(0.0, [0.0; 3])];
        for step in 0..20u32 {
            // Its end is thrown about, faster than anything moves, and farther than it reaches.
            let noise = vector(f64::from(step * 7).sin(), f64::from(step * 11).cos(), 0.3);
            let far = total * 0.9 * way + 0.05 * noise;
            let report = chain.step(dt, &[held[0], guide(total, far.into())], None);
            assert!(report.status != ChainStatus::Malformed);
            let too_far = far.norm() > total;
            let case = format!("dt {dt} EI {bending} step {step}: {report:?}");
            assert!(report.length_error < 1e-4 || too_far, "{case}");
            let most = 1.0001 * total.max(far.norm());
            assert!(chain.nodes_m().iter().all(|p| p.norm() < most), "{case}");
        }
        let mut before = f64::INFINITY;
        for step in 0..40 {
            let report = chain.step(dt, &held, None);
            let now = energy(&chain);
            let case = format!("dt {dt} EI {bending} step {step}: {report:?}, {before} to {now}");
            assert!(report.length_error < 1e-4, "{case}");
            assert!(now <= before + 1e-9 * before.abs(), "{case}");
            before = now;
        }
    }
}

/// Guides inside the chain are met, and the chain between them is as long as it is; the same bits and nothing allocated.
#[test]
fn guides_along_it_are_met_without_allocation() {
    let total = 0.2;
    let settings = ChainSettings::of_length(total);
    let skin = {
        let mesh = tube([0.008, 0.011], [-0.1, -0.07], [1, 20, 4]).expect("a tube");
        let at: Vec<Vector3<f64>> = mesh.points_m().iter().map(|p| Vector3::from(*p)).collect();
        (Skin::new(&mesh.surface().triangles, &at), at)
    };
    let run = |allocations: bool| {
        let mut chain = Chain::new(settings, &Vector3::zeros(), &Vector3::y()).expect("a chain");
        for step in 0..60 {
            // As through tissue, where it slides.
            let slid = 0.0301 + 2e-4 * f64::from(step);
            let guides = [
                guide(slid, [0.0, 0.030, 0.0]),
                guide(slid + 0.004, [0.004, 0.030, 0.0]),
                guide(slid + 0.009, [0.007, 0.032, 0.001]),
                guide(0.199, [0.03, 0.09, 0.01]),
            ];
            let mut report = None;
            let allocated = allocation_counter::measure(|| {
                report = Some(chain.step(2e-3, &guides, Some((&skin.0, &skin.1))));
            });
            assert!(!allocations || step == 0 || allocated.count_total == 0);
            let report = report.expect("a report");
            assert!(
                report.length_error < 1e-4 && report.status != ChainStatus::Malformed,
                "{step}: {report:?}"
            );
            // Nodes go past the guides along the chain; the line through them cuts corners only.
            let segment = total / 63.0;
            for guide in &guides {
                let node = ((guide.along_m / segment) as usize).min(61);
                let at = Vector3::from(guide.at_m);
                let near = chain.nodes_m()[node - 1..=node + 2]
                    .windows(2)
                    .flat_map(|ends| (0..=50).map(|k| ends[0].lerp(&ends[1], 0.02 * f64::from(k))));
                let off = near
                    .map(|p| p.metric_distance(&at))
                    .fold(f64::MAX, f64::min);
                assert!(off < 0.3 * segment, "{step}: {off} m off {guide:?}");
            }
        }
        chain
            .nodes_m()
            .iter()
            .map(|p| [p.x, p.y, p.z].map(f64::to_bits))
            .collect::<Vec<_>>()
    };
    assert_eq!(run(false), run(true));
}

#[test]
fn what_makes_no_chain_is_refused() {
    let settings = ChainSettings::of_length(0.1);
    let new =
        |settings: ChainSettings, way: Vector3<f64>| Chain::new(settings, &Vector3::zeros(), &way);
    assert!(new(settings, Vector3::zeros()).is_none());
    assert!(new(settings, vector(f64::NAN, 0.0, 0.0)).is_none());
    assert!(
        new(
            ChainSettings {
                nodes: 1,
                ..settings
            },
            Vector3::x()
        )
        .is_none()
    );
    assert!(
        new(
            ChainSettings {
                length_m: -1.0,
                ..settings
            },
            Vector3::x()
        )
        .is_none()
    );
    assert!(
        new(
            ChainSettings {
                bending_n_m2: f64::NAN,
                ..settings
            },
            Vector3::x()
        )
        .is_none()
    );
    let mut chain = new(settings, Vector3::x()).expect("a chain");
    let before = chain.nodes_m().to_vec();
    for guides in [
        vec![guide(0.05, [0.0; 3]), guide(0.04, [0.0; 3])],
        vec![guide(0.05, [f64::NAN; 3])],
        vec![guide(0.11, [0.0; 3])],
        vec![guide(-0.01, [0.0; 3])],
    ] {
        assert_eq!(
            chain.step(1e-3, &guides, None).status,
            ChainStatus::Malformed
        );
    }
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(chain.step(dt, &[], None).status, ChainStatus::Malformed);
    }
    assert_eq!(chain.nodes_m(), before);
}
