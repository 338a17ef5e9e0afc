//! Pictures of sessions: the same of a session and of its recording, nothing allocated to offer them, and what they show.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use sutura_hil::NativeConsole;
use sutura_host::picture::{Heard, Offer, Painter, Picture, Scalar, Showing};
use sutura_host::recording::replay::replay_host;
use sutura_host::recording::{About, Recorder, Recording, TappedConsole, TappedSolver};
use sutura_host::scene::{self, Document, Scene, Sources};
use sutura_host::session::{
    LINE_BYTES_PER_S, Plan, Rendering, SceneSolver, Snapshot, Solve, Solved, run_lockstep,
};
use sutura_host::thread::{Beats, Hanging};
use sutura_shared::wire::Valid;
use sutura_shared::wire::message::{Fixture, State};

pub fn open(name: &str) -> (Scene, Sources) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../scenes")
        .join(name);
    let document = Document::read(&path).expect("a scene");
    (scene::read(&document).expect("a scene"), document.sources())
}

pub fn plan(scene: &Scene, seconds: f64) -> Plan {
    Plan {
        device: scene.device.expect("a device").description,
        hand: scene.hand.expect("a hand"),
        host_hz: scene.host.host_hz,
        seconds,
        tick_hz: 1000,
        state_every: 1,
        rendering: Rendering::Rows,
        line_bytes_per_s: LINE_BYTES_PER_S,
        horizon_us: scene.host.horizon_us,
        clear_fault: false,
        fixture: Fixture::None,
    }
}

/// A solver whose pictures are drawn at once, every so many solves.
struct Drawn<'a> {
    shown: Showing<'a>,
    offer: Arc<Offer>,
    own: Box<Snapshot>,
    painter: &'a Painter,
    hanging: Option<Hanging>,
    heard: Option<Heard>,
    pictures: Vec<Picture>,
}

impl Solve for Drawn<'_> {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.shown.solve(state);
        if self.offer.take(&mut self.own) {
            let sequence = self.pictures.len() as u32 + 1;
            let scalar = Scalar::ALL[sequence as usize % Scalar::ALL.len()];
            if let (Some(heard), Some(hanging)) = (&mut self.heard, &mut self.hanging) {
                heard.up_to(&self.own, |beat, begins| {
                    assert_eq!(begins, sequence == 1, "no beat is missing");
                    beat.beat(hanging, &beat.positions_m());
                });
            }
            let (own, hanging) = (&self.own, self.hanging.as_mut());
            let picture = self.painter.paint(own, hanging, Some(scalar), sequence);
            self.pictures.push(picture);
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.shown.scene()
    }
}

/// A session in lockstep with its recording: trace hash, and pictures if `period_us` is above 0.
fn session(name: &str, seconds: f64, file: &Path, period_us: u64) -> (String, Vec<Picture>) {
    let (scene, sources) = open(name);
    let plan = plan(&scene, seconds);
    let about = About {
        lockstep: true,
        ..About::here("test".to_owned(), &plan, scene.tissue.word())
    };
    let recorder = Recorder::start(Some(file), about, sources).expect("a file");
    let mut solver = SceneSolver::for_session(&scene, &plan).expect("a solver");
    let painter = Painter::new(&scene, 1);
    let offer = Offer::new(&solver);
    offer.want(period_us);
    let own = Box::new(Snapshot::of(&solver));
    let hanging = solver.model().and_then(|model| Hanging::new(model));
    let mut heard = offer.heard();
    if let Some(heard) = &mut heard {
        heard.open(&own);
    }
    let tapped = TappedSolver::new(&mut solver, recorder.tap()).sketched(&scene);
    let mut drawn = Drawn {
        shown: Showing::new(tapped, Some(offer.clone())),
        offer,
        own,
        painter: &painter,
        hanging,
        heard,
        pictures: Vec::new(),
    };
    let mut console = NativeConsole::new(&plan.device).expect("a console");
    let mut console = TappedConsole::new(&mut console, recorder.tap());
    let summary = run_lockstep(&mut console, &plan, &mut drawn, |_| {
        ControlFlow::Continue(())
    });
    let summary = summary.expect("a session");
    let pictures = drawn.pictures;
    recorder.finish().expect("written");
    (summary.trace_hash, pictures)
}

fn bytes(picture: &Picture) -> Vec<u8> {
    let mut bytes = Vec::new();
    picture.encode(&mut bytes);
    bytes
}

/// Ten times a second a recording says where needles are, for programs that draw them, as pictures show them.
fn are_sketched(recording: &[u8], live: &[Picture], seconds: f64) {
    const BEGINS: &[u8] = br#"{"deletions":[],"entities":[{"#;
    // Nothing in a recording is compressed.
    let places = recording.windows(BEGINS.len()).enumerate();
    let places = places.filter(|(_, bytes)| *bytes == BEGINS);
    let sketches: Vec<serde_json::Value> = places
        .map(|(at, _)| {
            let mut values = serde_json::Deserializer::from_slice(&recording[at..]).into_iter();
            values.next().expect("a value").expect("JSON")
        })
        .collect();
    if live.iter().all(|picture| picture.needles.is_empty()) {
        assert!(sketches.is_empty(), "{} sketches", sketches.len());
        return;
    }
    let count = sketches.len() as f64;
    assert!((count - 10.0 * seconds).abs() < 3.0, "{count} sketches");
    let last = &sketches[sketches.len() - 1]["entities"][0];
    assert_eq!(last["frame_id"], "world");
    assert!(
        last["id"]
            .as_str()
            .is_some_and(|id| id.starts_with("needle ")),
        "{last}"
    );
    let points = last["lines"][0]["points"].as_array().expect("points");
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let time_us =
        1e6 * number(&last["timestamp"]["sec"]) + 1e-3 * number(&last["timestamp"]["nsec"]);
    let apart_us = |picture: &&Picture| (picture.console_time_us as f64 - time_us).abs() as u64;
    let picture = live.iter().min_by_key(apart_us).expect("a picture");
    // A needle's line begins at its frame; between a sketch and the nearest picture it does not go far.
    let begin = ["x", "y", "z"].map(|axis| number(&points[0][axis]));
    let way: f64 = begin
        .iter()
        .zip(&picture.needles[0].position_m)
        .map(|(a, b)| (a - b).powi(2))
        .sum();
    assert!(points.len() > 10 && way.sqrt() < 2e-3, "{} m", way.sqrt());
}

/// Offering and drawing pictures leaves no trace: hash and recorded bytes are the same. And what the recording shows when it
/// is run again is what was shown, to the byte.
fn are_the_same_live_and_again(name: &str, seconds: f64) -> Vec<Picture> {
    let folder = tempfile::tempdir().expect("a folder");
    let [seen, unseen] = ["seen.mcap", "unseen.mcap"].map(|name| folder.path().join(name));
    let (hash, live) = session(name, seconds, &seen, 33_333);
    let (plain_hash, none) = session(name, seconds, &unseen, 0);
    assert_eq!(hash, plain_hash);
    assert!(
        none.is_empty() && live.len() as f64 > 20.0 * seconds,
        "{} pictures",
        live.len()
    );
    let [seen_bytes, unseen_bytes] =
        [&seen, &unseen].map(|file| std::fs::read(file).expect("a file"));
    assert!(seen_bytes == unseen_bytes, "recordings differ");
    are_sketched(&seen_bytes, &live, seconds);

    let recording = Recording::read(&seen).expect("a recording");
    let scene = scene::read(&Document::from_sources(&recording.sources)).expect("a scene");
    let mut solver = SceneSolver::for_session(&scene, &recording.about.plan).expect("a solver");
    let painter = Painter::new(&scene, 1);
    let mut own = Snapshot::of(&solver);
    let mut hanging = solver.model().and_then(|model| Hanging::new(model));
    let mut beats = Beats::default();
    let (mut solves, mut next) = (0, live.iter());
    let mut expected = next.next();
    let verdict = replay_host(&recording, &mut solver, true, |solver, here| {
        solves += 1;
        // A file of lockstep says no times; these are of running it again.
        let stages_us: f64 = here.stages_us.iter().sum();
        assert!(
            0.0 < stages_us && stages_us < here.step_us + 0.1,
            "{here:?}"
        );
        let is_beat = beats.is_due(here.console_time_us);
        if let Some(hanging) = hanging.as_mut().filter(|_| is_beat) {
            solver.snapshot(&mut own);
            own.beat(hanging, &own.positions_m());
        }
        if let Some(picture) = expected.filter(|picture| picture.solves == solves) {
            solver.snapshot(&mut own);
            own.solves = solves;
            let scalar = picture.scalar.as_ref().map(|(scalar, _)| *scalar);
            let again = painter.paint(&own, hanging.as_mut(), scalar, picture.sequence);
            assert!(
                bytes(&again) == bytes(picture),
                "picture {} of {name}",
                picture.sequence
            );
            expected = next.next();
        }
    });
    assert!(verdict.identical && verdict.why.is_none(), "{verdict:?}");
    assert!(expected.is_none(), "every picture was seen again");
    live
}

#[test]
fn pictures_of_a_palpation_are_the_same_live_and_again() {
    let live = are_the_same_live_and_again("palpation.toml", 1.5);
    // The tissue is pressed in, and what is shown says so.
    let pressed = live
        .iter()
        .rfind(|picture| picture.tools[0].wrench[2] > 0.1)
        .expect("a touch");
    assert!(pressed.status.touches && pressed.tools[0].rows > 0 && pressed.tools[0].driven);
    let deepest = pressed
        .displacement_m
        .iter()
        .map(|u| u[2])
        .fold(0.0, f64::min);
    assert!(deepest < -1e-4, "{deepest} m");
    // Forces on the boundary are what the tool feels, the other way round.
    let pushed: f64 = pressed.contacts.iter().map(|(_, force_n)| force_n[2]).sum();
    let felt = pressed.tools[0].wrench[2];
    assert!(
        (pushed + felt).abs() < 0.05 * felt,
        "{pushed} N for {felt} N"
    );
    for scalar in Scalar::ALL {
        let touched = live
            .iter()
            .filter(|picture| picture.tools[0].wrench[2] > 0.1);
        let mut of = touched.filter_map(|picture| picture.scalar.as_ref());
        let of = of.find(|(found, _)| *found == scalar);
        let (_, values) = of.unwrap_or_else(|| panic!("{scalar:?}"));
        assert_eq!(values.len(), pressed.displacement_m.len());
        assert!(values.iter().all(|value| value.is_finite()), "{scalar:?}");
        assert!(values.iter().any(|value| *value != 0.0), "{scalar:?}");
    }
}

#[test]
fn pictures_of_needle_and_thread_are_the_same_live_and_again() {
    let live = are_the_same_live_and_again("anastomosis-20.toml", 1.2);
    let last = live.last().expect("pictures");
    assert!(!last.needles.is_empty());
    let turned = last.needles[0].orientation;
    let norm: f64 = turned.iter().map(|x| x * x).sum();
    assert!((norm - 1.0).abs() < 1e-9);
    let hangs = |picture: &Picture| {
        picture.threads[0]
            .points
            .iter()
            .any(|point| point.what == 5)
    };
    assert!(live.iter().all(hangs));

    // Fewer pictures show the same: what hangs does not know how often it is looked at.
    let folder = tempfile::tempdir().expect("a folder");
    let (_, seldom) = session(
        "anastomosis-20.toml",
        1.2,
        &folder.path().join("seldom.mcap"),
        70_000,
    );
    let mut both = 0;
    for picture in &seldom {
        let same = live
            .iter()
            .find(|other| other.console_time_us == picture.console_time_us);
        both += u32::from(same.is_some_and(|other| other.threads == picture.threads));
        assert!(same.is_none_or(|other| other.threads == picture.threads));
    }
    assert!(
        both >= 2,
        "{both} of {} pictures at the same time",
        seldom.len()
    );
}

/// Values of triangles come to the vertices by area; a constant stays what it is.
#[test]
fn averages_keep_constants() {
    let (scene, _) = open("palpation.toml");
    let painter = Painter::new(&scene, 1);
    let boundary = painter.boundary();
    let same = boundary.by_area(&vec![7.5; boundary.triangles.len()]);
    assert!(same.iter().all(|value| (value - 7.5).abs() < 1e-9));
    // A force along a vertex's inward normal presses; the whole is what was put in.
    let vertex = boundary.nodes.len() as u32 / 2;
    let pressure = boundary.pressure_pa(&[(vertex, [0.0, 0.0, -1.0])]);
    assert!(pressure.iter().filter(|value| **value != 0.0).count() <= 1);
}

/// A snapshot takes no memory once it has been made, of linear tissue with and without needles, and of tissue that turns.
#[test]
fn a_snapshot_allocates_nothing() {
    for (name, tissue) in [
        ("palpation.toml", "linear"),
        ("palpation.toml", "corotational"),
        ("palpation.toml", "chainmail-ellipsoid"),
        ("anastomosis-20.toml", "linear"),
    ] {
        let (mut scene, _) = open(name);
        let named = scene::Tissue::named(tissue).expect("a tissue");
        scene.tissue = named.instead_of(scene.tissue);
        let plan = Plan {
            rendering: scene.usual_rendering(),
            ..plan(&scene, 0.4)
        };
        let mut solver = SceneSolver::for_session(&scene, &plan).expect("a solver");
        let snapshot = Snapshot::of(&solver);
        let mut copying = Copying {
            solver: &mut solver,
            snapshot,
            copies: 0,
            allocated: 0,
        };
        let mut console = NativeConsole::new(&plan.device).expect("a console");
        let ran = run_lockstep(&mut console, &plan, &mut copying, |_| {
            ControlFlow::Continue(())
        });
        ran.expect("a session");
        assert!(
            copying.copies > 10,
            "{name}, {tissue}: {} copies",
            copying.copies
        );
        assert_eq!(copying.allocated, 0, "{name}, {tissue}");
        // The counter does see memory.
        let allocated = allocation_counter::measure(|| drop(Snapshot::of(&solver)));
        assert!(allocated.count_total > 0);
    }
}

struct Copying<'a> {
    solver: &'a mut SceneSolver,
    snapshot: Snapshot,
    copies: u32,
    allocated: u64,
}

impl Solve for Copying<'_> {
    fn solve(&mut self, state: &Valid<State>) -> Solved {
        let solved = self.solver.solve(state);
        let allocated = allocation_counter::measure(|| self.solver.snapshot(&mut self.snapshot));
        self.copies += 1;
        // What grows for the first time may take memory.
        if self.copies > 1 {
            self.allocated += allocated.count_total;
        }
        solved
    }

    fn scene(&self) -> serde_json::Map<String, serde_json::Value> {
        self.solver.scene()
    }
}
