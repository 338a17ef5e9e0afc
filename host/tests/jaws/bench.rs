//! What sixty rows of jaws beside a needle cost: `cargo test --release -p sutura-host --test all sixty_rows -- --ignored --nocapture`.

use super::rig::{Rig, SOFT, at, moved, sample};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::time::Instant;
use sutura_host::fem::Loads;
use sutura_host::jaws::Jaws;
use sutura_host::mesh::slab;
use sutura_host::model::Model;
use sutura_host::needle::{Needle, NeedlePart, NeedleSettings, NeedleShape, NeedleTissue};
use sutura_host::tool::{Shape, Tool};

/// Tool of the needle.
const HOLDER: u8 = 9;
const STEPS: u32 = 400;

/// A block of 4,998 nodes with 20 points in the jaws, lifted, and a needle 12 mm deep beside them.
#[test]
#[ignore = "times"]
fn sixty_rows_beside_a_needle() {
    let mesh = slab([0.08, 0.06, 0.03], [20, 16, 13]).expect("a block");
    let jaws = Jaws {
        points: 20,
        width_m: 0.012,
        ..Jaws::new(4.0, 0.5)
    };
    let down = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
    let mut rig = Rig::on(mesh, &[jaws], |mesh, fixed, tools| {
        let mut tools = tools.to_vec();
        tools.push((HOLDER, Tool::new(Shape::Grip, [0.0; 3])));
        let model = Model::new(mesh, SOFT, fixed, Loads::default(), &tools).expect("tissue");
        let part = NeedlePart {
            weight: None,
            id: 0,
            needle: Needle {
                shape: NeedleShape::Straight { length_m: 0.04 },
                thickness_m: 6e-4,
            },
            start: Isometry3::from_parts(Vector3::new(0.0251, 0.0007, 0.045).into(), down),
            body: false,
        };
        let answer = NeedleTissue {
            friction_n_per_m: 10.0,
            static_friction_n_per_m: 10.0,
            viscous_n_s_per_m2: 0.0,
            cutting_pa: 1e5,
            puncture_pa: 2e5,
            surface_friction: f64::INFINITY,
        };
        let tissue = vec![answer; mesh.cells().len()];
        let settings = NeedleSettings::default();
        model
            .with_needles(mesh, &[part], &tissue, settings)
            .expect("a needle")
    });
    rig.work.prepare(&rig.model, |_| true);
    let pose = at(-0.005, 0.001, -0.006);
    let holder = |z: f64| sample(HOLDER, &at(0.0251, 0.0007, z));
    let go = |rig: &mut Rig, jaws: &Isometry3<f64>, z: f64| {
        let samples = [sample(1, jaws), holder(z)];
        let options = rig.options;
        let (model, state, work) = (&rig.model, &mut rig.state, &mut rig.work);
        sutura_host::step::step(model, state, &samples, &options, work)
    };
    go(&mut rig, &pose, 0.045);
    rig.state.hold(&rig.model, 0, Some(&holder(0.045)));
    for k in 1..=170 {
        go(&mut rig, &pose, 0.045 - 1e-4 * f64::from(k));
    }
    rig.state.act(&rig.model, sutura_host::tool::Act::Close(1));
    go(&mut rig, &pose, 0.028);
    let (mut times, mut rows, mut needle) = (Vec::new(), 0, 0);
    for k in 0..STEPS {
        let phase = f64::from(k) / f64::from(STEPS) * std::f64::consts::TAU;
        let lifted = moved(&pose, 2, 0.002 * (1.0 - phase.cos()));
        let began = Instant::now();
        let report = go(&mut rig, &lifted, 0.028);
        times.push(began.elapsed().as_secs_f64() * 1e3);
        assert_eq!(report.status.name(), "ok");
        rows = report.jaws()[0].points * 3;
        needle = report.needles()[0].crossings;
    }
    times.sort_by(f64::total_cmp);
    let [p50, p99] = [0.5, 0.99].map(|p| times[(p * f64::from(STEPS)) as usize]);
    let nodes = rig.mesh.points_m().len();
    println!(
        "{nodes} nodes, {rows} rows of jaws, {needle} crossings: {p50:.3} ms, p99 {p99:.3} ms"
    );
}
