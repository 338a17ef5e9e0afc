//! A scene pays for nothing that it does not name: bytes that its model, state and workspace hold.

use super::balance::BalanceWork;
use super::tangent::TangentWork;
use super::{SourcesWork, State, Workspace};
use crate::collide::TouchWork;
use crate::model::Model;
use crate::needle::NeedleWork;
use crate::scene::{Document, Scene};
use crate::source::tool::{ToolContacts, ToolWork};
use crate::thread::ThreadWork;
use nalgebra::Matrix3;

const TISSUE: &str = r#"
[mesh.slab]
size_m = [0.06, 0.06, 0.03]
divisions = [8, 8, 4]

[tissue]
youngs_modulus_pa = 10e3
poisson_ratio = 0.4

[[fixed]]
plane = { axis = "z", at_m = -0.03 }
"#;
const SPHERE: &str = "[[tool]]\nid = 1\nradius_m = 0.02\n";
/// Held beside another.
const HELD: &str = "driven = false\nposition_m = [0.02, 0.0, 0.03]\n";
const RUBS: &str = "friction = 0.3\n";
const GRIP: &str = "[[tool]]\nid = 0\nshape = \"grip\"\n";
const NEEDLE: &str = r#"
[tissue.needle]
friction_n_per_m = 25.0
cutting_pa = 1e5
puncture_pa = 5e5

[[needle]]
shape = "straight"
length_m = 0.03
thickness_m = 0.0008
end_m = [0.001, 0.0007, 0.05]
direction = [0.0, 0.0, -1.0]

[[needle.hold]]
time_s = 0.0
tool = 0
"#;
const THREAD: &str = "[[thread]]\nneedle = 0\nlength_m = 0.2\n";
const SPRING: &str = "[[spring]]\nfrom_m = [0.0, 0.0, 0.0]\nto_m = [0.0, 0.0, 0.03]\nto_is_fixed = true\n\
                      stiffness_n_per_m = 10.0\nlength_m = 0.03\n";

fn model(parts: &[&str]) -> Model {
    let text = format!("{TISSUE}{}", parts.concat());
    let document = Document::embedded("test.toml", "".as_ref(), &text);
    let scene = Scene::read(&document, "test").expect("a good scene");
    scene.build().expect("a good model").0
}

/// Bytes that what is made holds.
fn held<T>(make: impl FnOnce() -> T) -> u64 {
    let mut made = None;
    let counted = allocation_counter::measure(|| made = Some(make()));
    drop(made);
    u64::try_from(counted.bytes_current).expect("no less than before")
}

/// Bytes of state and workspace.
fn evolving(model: &Model) -> [u64; 2] {
    [held(|| State::new(model)), held(|| Workspace::new(model))]
}

/// Bytes of what needles, threads, tools and tissues that touch have of their own.
fn rooms(model: &Model) -> [u64; 4] {
    let sources = model.sources.as_ref().expect("something acts");
    let rows = sources.anchor_settings().most_rows;
    let needles = sources.needles.len();
    let tools = || {
        let work = ToolWork::new(&sources.tools, rows);
        let contacts = ToolContacts::new(&sources.tools);
        (work, sources.tools.cones(rows), contacts)
    };
    let touching = || {
        let touching = sources.touching.as_ref();
        touching.map(|touching| TouchWork::new(touching, sources.mesh.nodes()))
    };
    [
        held(|| NeedleWork::new(needles, sources)),
        held(|| ThreadWork::new(sources)),
        held(tools),
        held(touching),
    ]
}

#[test]
fn tissue_alone_has_no_workspace() {
    assert_eq!(evolving(&model(&[])), [0, 0]);
    assert!(model(&[]).sources.is_none());
}

/// Needles, threads, tools and tissues that touch, by who is there.
#[test]
fn who_is_not_named_has_no_room() {
    let scenes: [(&[&str], [bool; 4]); 7] = [
        (&[SPHERE], [false, false, true, false]),
        (&[SPHERE, RUBS], [false, false, true, false]),
        (&[SPRING], [false; 4]),
        (&[GRIP, SPRING], [false; 4]),
        (&[GRIP, NEEDLE], [true, false, false, false]),
        (&[GRIP, NEEDLE, THREAD], [true, true, false, false]),
        (&[GRIP, SPHERE, HELD, NEEDLE], [true, false, true, false]),
    ];
    for (parts, named) in scenes {
        let rooms = rooms(&model(parts));
        assert_eq!(rooms.map(|bytes| bytes > 0), named, "{parts:?}: {rooms:?}");
    }
}

/// What a source needs comes with it, in the workspace and, of what it remembers, in the state.
#[test]
fn every_source_pays_for_itself() {
    let pairs: [(&[&str], &[&str]); 5] = [
        (&[], &[SPHERE]),
        (&[SPHERE], &[SPHERE, RUBS]),
        (&[GRIP], &[GRIP, NEEDLE]),
        (&[GRIP, NEEDLE], &[GRIP, NEEDLE, THREAD]),
        (&[SPHERE], &[SPHERE, SPRING]),
    ];
    for (without, with) in pairs {
        let ([state, work], [more, room]) = (evolving(&model(without)), evolving(&model(with)));
        assert!(
            more > state && room > work,
            "{with:?}: {state} {more} {work} {room}"
        );
    }
    // A grip touches nothing: it is a sample among others.
    let [alone, held] = [&[SPRING][..], &[GRIP, SPRING]].map(|parts| evolving(&model(parts)));
    assert_eq!(alone, held);
}

/// Rows are what most memory goes by: those of one source are not those of all.
#[test]
fn room_for_rows_is_of_what_is_named() {
    let rows = |parts: &[&str]| {
        let model = model(parts);
        let sources = model.sources.as_ref().expect("something acts");
        let (settings, work) = (sources.anchor_settings(), SourcesWork::new(&model, sources));
        let BalanceWork { set, .. } = &work.balance;
        assert!(set.rows.capacity() >= settings.most_rows);
        settings.most_rows
    };
    let (smooth, rubbing, spring) = (rows(&[SPHERE]), rows(&[SPHERE, RUBS]), rows(&[SPRING]));
    assert_eq!((rubbing, spring), (3 * smooth, 3));
    assert_eq!(rows(&[SPHERE, SPRING]), smooth + spring);
    assert_eq!(rows(&[GRIP, SPRING]), spring);
    // So is scratch for what tools feel.
    let tangent = |contacts| held(|| TangentWork::new(1000, contacts));
    assert!(tangent(1) - tangent(0) > 1000 * size_of::<Matrix3<f64>>() as u64);
}
