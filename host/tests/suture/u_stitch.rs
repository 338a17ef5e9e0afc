//! A U stitch against the least energy: the tissue's and the thread's, from rest.

use super::least::{Least, Suture, turning};
use super::one_length::*;
use crate::driving::bench::{Bench, MATERIAL};
use nalgebra::Vector3;
use sutura_host::thread::{ThreadPlace, ThreadPoint, ThreadReport, Through};

/// Distance of its punctures \[m\].
fn between_m(path: &[ThreadPoint]) -> f64 {
    let of = |what: ThreadPlace| path.iter().find(|point| point.what == what);
    let [enters, leaves] = [ThreadPlace::Enters, ThreadPlace::Leaves].map(of);
    let at = |point: Option<&ThreadPoint>| Vector3::from(point.expect("a puncture").at_m);
    at(enters).metric_distance(&at(leaves))
}

/// The same stitch with the hands where they are now.
fn least(bench: &Bench, found: impl Fn(&Suture) -> Least) -> (Least, f64) {
    let mesh = thick(sides);
    let rest_m = bench.model.points_m();
    let path = bench.state.thread_path(&bench.model, 7, rest_m);
    let path = turning(&path, 0.15 * mesh.0.surface().mean_edge_m);
    let suture = Suture::new((&mesh.0, &mesh.1), |_| MATERIAL, &path, None);
    let least = found(&suture);
    let nodes_m: Vec<[f64; 3]> = least.at.iter().map(|at| (*at).into()).collect();
    let path = bench.state.thread_path(&bench.model, 7, &nodes_m);
    (least, between_m(&path))
}

/// Pulled at both ends a little at a time; what the thread and its punctures do while it is taut.
fn bunched(through: Through, mut each: impl FnMut(&Bench, &ThreadReport, f64)) {
    let mut bench = wound_up_in(thick(sides), 1, part(through));
    let at_rest_m = between_m(&bench.path(7));
    assert!(bench.largest_displacement_m() < 1e-12);
    let mut before_m = at_rest_m;
    for _ in 0..6 {
        for _ in 0..8 {
            bench.grip.translation.vector.z += 2e-4;
            bench.other.translation.vector.z += 2e-4;
            assert_eq!(bench.step_both().status.name(), "ok");
        }
        let thread = bench.step_both().threads()[0];
        if thread.tension_n[1] == 0.0 {
            continue;
        }
        assert_eq!(thread.wraps, 0);
        let now_m = between_m(&bench.path(7));
        each(&bench, &thread, now_m);
        assert!(now_m < before_m, "{now_m} {before_m}");
        before_m = now_m;
    }
    assert!(before_m < 0.9 * at_rest_m, "{before_m}");
}

/// It bunches the tissue between its punctures as the least energy with its tension has it, the more the harder it is pulled.
#[test]
fn a_u_stitch_bunches_as_the_least_energy_has_it() {
    bunched(Through::default(), |bench, thread, now_m| {
        let tension_n = thread.tension_n[1];
        let (least, expected_m) = least(bench, |suture| suture.pulled(tension_n));
        println!(
            "{tension_n} N: {now_m} m, least energy {expected_m} m, length {} and {} m",
            thread.length_m, least.length_m
        );
        assert!((now_m / expected_m - 1.0).abs() < 1e-4);
        assert!((thread.length_m / least.length_m - 1.0).abs() < 1e-4);
    });
}

/// The same of a thread that stretches, by how much of it there is between the hands.
#[test]
fn a_u_stitch_is_as_tense_as_the_least_energy_of_its_length_has_it() {
    bunched(ELASTIC, |bench, thread, now_m| {
        let tension_n = thread.tension_n[1];
        let (least, expected_m) = least(bench, |suture| suture.drawn(thread.available_m, EA_N));
        println!(
            "{tension_n} N of {} N: {now_m} m, least energy {expected_m} m",
            least.tension_n
        );
        assert!((tension_n / least.tension_n - 1.0).abs() < 1e-4);
        assert!((now_m / expected_m - 1.0).abs() < 1e-4);
    });
}
