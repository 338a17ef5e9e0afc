//! A thread that rubs, pulled at both ends, against the capstan equation and the least energy with the tensions that it says.

use super::pull::passages;
use super::whole::{REST, Sewn};
use nalgebra::Vector3;
use sutura_host::step::{State, Status, StepOptions, Workspace, step};
use sutura_host::thread::{ThreadPlace, ThreadPoint};
use sutura_testkit::full;

/// What bridges the gap in a bite that is closed is no longer than this part of what it was.
const CLOSED: f64 = 0.05;
/// Most that tensions of spans are off, and what bridges the gap over what it was.
const TENSION_OFF: f64 = 0.05;
const RATIO_OFF: f64 = 0.005;

impl Sewn {
    /// Pulls at tail and head in steps of a 300th of their ways, at each while `goes_on` with the tensions there and with what bridges the gap, and
    /// rests.
    fn pulled_while(&self, mut goes_on: impl FnMut([f64; 2], &[f64]) -> [bool; 2]) -> State {
        let (model, _, _) = self.solver.parts().expect("rows");
        let mut state = self.state.clone();
        let mut work = Workspace::new(model);
        let mut time_us = 0;
        let (mut parts, mut pulls, mut rests) = ([0.0; 2], [true; 2], 0);
        while rests < REST {
            time_us += 5000;
            for (part, pulls) in parts.iter_mut().zip(pulls) {
                *part += f64::from(u8::from(pulls)) / 300.0;
            }
            let [tail, head] = parts;
            assert!(tail.max(head) < 3.0, "{parts:?}");
            let samples = self.samples(1.0, [head, tail], time_us);
            let report = loop {
                let options = StepOptions::default();
                let report = step(model, &mut state, &samples, &options, &mut work);
                if !matches!(report.status, Status::Waiting | Status::Behind) {
                    break report;
                }
            };
            if report.status != Status::Ok {
                eprintln!("NOT {parts:?} {:?} {}", report.status, report.residual);
                continue;
            }
            let ratios = self.ratios(&state, &state.positions(model));
            pulls = goes_on(report.threads()[0].tension_n, &ratios);
            rests = if pulls == [false; 2] { rests + 1 } else { 0 };
        }
        state
    }

    /// Of each bite what bridges the gap with the nodes there, over that before. A bite has two passages; where more spans bridge the gap
    /// than there are bites, as those back over a slit do, bites are every second one.
    fn ratios(&self, state: &State, nodes_m: &[[f64; 3]]) -> Vec<f64> {
        let (model, _, _) = self.solver.parts().expect("rows");
        let bites = passages(&state.thread_path(model, 0, nodes_m)).len() / 2;
        let bridges = state.bridges(model, 0, nodes_m);
        let each = bridges.iter().step_by(bridges.len().div_ceil(bites));
        each.map(|one| one.now_m / one.rest_m).collect()
    }

    /// The tension at which all bites are closed \[N\].
    fn closing_n(&self) -> f64 {
        let mut closing_n = 0.0;
        self.pulled_while(|[tail_n, _], ratios| {
            closing_n = tail_n;
            [ratios.iter().any(|ratio| *ratio > CLOSED); 2]
        });
        closing_n
    }
}

/// Of a path the tension in each piece, if at its ends it is those and each passage through tissue holds it back as a capstan does: by as much
/// as it turns there, evenly along it \[N\].
fn by_capstan(path: &[ThreadPoint], friction: f64, [tail_n, head_n]: [f64; 2]) -> Vec<f64> {
    let turns: Vec<f64> = passages(path).into_iter().map(|(_, turn)| turn).collect();
    let held_back = |turns: &[f64]| (-friction * turns.iter().sum::<f64>()).exp();
    let spans = (0..=turns.len()).map(|span| {
        let (before, behind) = turns.split_at(span);
        (tail_n * held_back(before)).max(head_n * held_back(behind))
    });
    let spans: Vec<f64> = spans.collect();
    let ways = path.windows(2).map(|two| {
        let [from, to] = [0, 1].map(|end| Vector3::from(two[end].at_m));
        (two[0].what, (to - from).norm())
    });
    let ways: Vec<(ThreadPlace, f64)> = ways.collect();
    let (mut span, mut gone_m, mut whole_m) = (0, 0.0, 0.0);
    let pieces = ways.iter().enumerate().map(|(place, (what, way_m))| {
        match what {
            ThreadPlace::Enters => {
                let inside = ways[place..].iter();
                let inside = inside.take_while(|(what, _)| *what != ThreadPlace::Leaves);
                (gone_m, whole_m) = (0.0, inside.map(|(_, way_m)| way_m).sum());
            }
            ThreadPlace::Leaves => (span, whole_m) = (span + 1, 0.0),
            _ => {}
        }
        if whole_m == 0.0 {
            return spans[span];
        }
        let middle = (gone_m + 0.5 * way_m) / whole_m;
        gone_m += way_m;
        spans[span] + (spans[span + 1] - spans[span]) * middle
    });
    pieces.collect()
}

/// Both ends pulled with 1.2 times the tension that closes all bites of a thread without friction: one that rubs has in each span what the turns
/// on the way leave of the nearer end's tension, and closes the bites that such tensions close by an independent solver.
#[test]
fn a_thread_that_rubs_closes_what_the_capstans_tensions_do() {
    let cases = [
        ("wound-slabs.toml", &[0.1, 0.3][..]),
        ("anastomosis-20.toml", &[0.1, 0.3]),
        ("anastomosis-50.toml", &[0.1]),
    ];
    for (name, frictions) in &cases[..if full() { 3 } else { 1 }] {
        let most_n = 1.2 * Sewn::that_rubs(name, 0.0).closing_n();
        for friction in *frictions {
            let sewn = Sewn::that_rubs(name, *friction);
            let mut ends_n = [0.0; 2];
            let state = sewn.pulled_while(|tensions_n, _| {
                ends_n = tensions_n;
                tensions_n.map(|tension_n| tension_n < most_n)
            });
            let (model, _, _) = sewn.solver.parts().expect("rows");
            let nodes_m = state.positions(model);
            // The same points with all nodes at rest and where they are.
            let [all, all_now] =
                [model.points_m(), &nodes_m].map(|nodes_m| state.thread_path(model, 0, nodes_m));
            let at_rest = sewn.turning(&all);
            let mut kept = at_rest.iter().peekable();
            let both = all.iter().zip(all_now);
            let now = both.filter_map(|(rest, now)| kept.next_if_eq(&rest).map(|_| now));
            let now: Vec<ThreadPoint> = now.collect();
            let says_n = by_capstan(&now, *friction, ends_n);
            let spans = now
                .iter()
                .zip(&says_n)
                .filter(|(point, _)| matches!(point.what, ThreadPlace::End | ThreadPlace::Leaves));
            let off = spans.map(|(point, said_n)| (point.tension_n / said_n - 1.0).abs());
            let off = off.fold(0.0, f64::max);
            println!("{name} {friction}: ends {ends_n:?} N, spans off by {off}");
            assert!(off < TENSION_OFF, "{name} {friction}: {off}");
            let least = sewn.suture_of(&at_rest).in_shares(says_n).pulled(1.0);
            let least_m: Vec<[f64; 3]> = least.at.iter().map(|at| (*at).into()).collect();
            let [ratios, least] = [&nodes_m, &least_m].map(|nodes_m| sewn.ratios(&state, nodes_m));
            println!("{ratios:?}\n{least:?}");
            for (ratio, least) in ratios.iter().zip(&least) {
                assert!(
                    (ratio - least).abs() < RATIO_OFF,
                    "{name} {friction}: {ratio} {least}"
                );
            }
            let [closed, says] = [ratios, least]
                .map(|ratios| ratios.iter().filter(|ratio| **ratio <= CLOSED).count());
            assert!(
                closed.abs_diff(says) <= 1,
                "{name} {friction}: {closed} {says}"
            );
        }
    }
}
