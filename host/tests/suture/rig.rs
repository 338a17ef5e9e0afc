//! Tissue, a needle with a thread, and two tools.

pub use crate::driving::bench::*;
use nalgebra::Vector3;
use sutura_host::collide::{TouchPart, TouchSettings};
use sutura_host::needle::{NeedleSettings, NeedleTissue};
use sutura_host::step::{State, StepReport, Workspace};
use sutura_host::thread::{
    HandReport, ThreadEnd, ThreadHold, ThreadPart, ThreadPoint, ThreadTension, Through,
};

/// A straight needle above two slabs, with a thread.
#[derive(Clone, Copy)]
pub struct Setup {
    pub friction: f64,
    pub strength_n: f64,
    pub touches: bool,
    pub gap_m: f64,
    pub length_m: f64,
    pub through: Through,
    /// Where the needle goes down \[m\].
    pub at_m: [f64; 2],
}

/// Without drag, in grips and knots that do not give way.
pub const INEXTENSIBLE: Through = Through {
    axial_stiffness_n: f64::INFINITY,
    drag_n_per_m: 0.0,
    grip_n: f64::INFINITY,
    knot_n: f64::INFINITY,
    thickness_m: 0.3e-3,
    tear_pa: f64::INFINITY,
    strands: 2,
    body: false,
};

/// Of a soft thread \[N\].
pub const SOFT_EA_N: f64 = 20.0;

pub const SETUP: Setup = Setup {
    friction: 0.0,
    strength_n: 20.0,
    touches: false,
    gap_m: 0.004,
    length_m: 0.3,
    // It stretches before it breaks.
    through: Through {
        axial_stiffness_n: SOFT_EA_N,
        ..INEXTENSIBLE
    },
    at_m: [0.0013, 0.0007],
};

/// Tissue without friction on a needle, and cut without force.
pub fn smooth() -> NeedleTissue {
    NeedleTissue {
        friction_n_per_m: 0.0,
        static_friction_n_per_m: 0.0,
        cutting_pa: 0.0,
        ..tissue()
    }
}

pub fn bench(setup: Setup) -> Bench {
    let [x, y] = setup.at_m;
    let start = frame(
        [x, y, 0.05 + setup.gap_m],
        [0.0, 0.0, -1.0],
        [1.0, 0.0, 0.0],
    );
    let tissue = smooth();
    let settings = NeedleSettings::default();
    let slabs = slabs_apart(setup.gap_m);
    let mut bench = Bench::new(slabs, Kind::Linear, straight(0.04), start, tissue, settings);
    let part = ThreadPart {
        id: 7,
        needle: 0,
        length_m: setup.length_m,
        friction: setup.friction,
        strength_n: setup.strength_n,
        through: setup.through,
    };
    let faces = |upper: bool| {
        let faces = bench.mesh.surface().triangles.into_iter();
        // The lower slab has the second half of the nodes.
        let first = bench.mesh.points_m().len() as u32 / 2;
        faces.filter(|face| (face[0] < first) == upper).collect()
    };
    let touching = TouchPart {
        faces: [faces(true), faces(false)],
        friction: 0.0,
    };
    bench.model = bench.model.with_threads(&[part]).expect("a thread");
    if setup.touches {
        bench.model = bench
            .model
            .with_touching(&bench.mesh, &[touching], TouchSettings::default())
            .expect("bodies");
    }
    bench.state = State::new(&bench.model);
    bench.work = Workspace::new(&bench.model);
    bench.work.prepare(&bench.model, |_| true);
    assert!(bench.hold(0, Some(0)));
    bench
}

/// Moves the grip by so much, in steps of 0.2 mm.
pub fn go(bench: &mut Bench, way: Vector3<f64>) -> StepReport {
    let steps = (way.norm() / 2e-4).ceil() as usize;
    let mut report = StepReport::default();
    for _ in 0..steps {
        bench.grip.translation.vector += way / steps as f64;
        report = bench.step_both();
        assert_eq!(report.status.name(), "ok");
    }
    report
}

/// Through both slabs and a little aside, with the tail in the hands of tool 1, still slack.
pub fn drawn(mut bench: Bench) -> Bench {
    go(&mut bench, Vector3::new(0.0, 0.0, -0.072));
    let report = go(&mut bench, Vector3::new(0.003, 0.0, -0.003));
    assert_eq!(report.threads()[0].punctures, 4);
    assert_eq!(report.threads()[0].state, ThreadTension::Slack);
    bench.other.translation.vector = Vector3::new(0.001, 0.002, 0.03);
    hold(&mut bench, ThreadEnd::Tail, ThreadHold::Tool(1));
    bench
}

/// What the only hand between ends of threads has.
pub fn only_hand(report: &StepReport) -> HandReport {
    assert_eq!(report.hands().len(), 1, "{:?}", report.hands());
    report.hands()[0]
}

pub fn hold(bench: &mut Bench, end: ThreadEnd, by: ThreadHold) {
    let samples = [bench.sample_of(0), bench.sample_of(1)];
    assert!(bench.state.hold_thread(&bench.model, 7, end, by, &samples));
}

/// The points of a path that it turns at: faces inside that are nearer to each other than 0.15 mean edges share one.
pub fn turning(bench: &Bench, path: &[ThreadPoint]) -> Vec<ThreadPoint> {
    super::least::turning(path, 0.15 * bench.mesh.surface().mean_edge_m)
}
