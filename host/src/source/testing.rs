//! What tests of sources share.

use crate::scene::{Document, Scene};
use crate::step::{State, StepOptions, StepReport, step};
use crate::tool::ToolSample;
use nalgebra::{Matrix6, UnitQuaternion, Vector3, Vector6};

/// Way of a difference \[m\], and turn \[rad\].
const DIFFERENCE: f64 = 1e-6;

/// A step to where the first tool of a scene is held, and how far its tangent is from central differences of whole steps,
/// over the largest difference (6 x 6): a metre counts as much as a radian over `length_m`.
pub(crate) fn held(scene: &str, length_m: f64) -> (StepReport, f64) {
    let document = Document::embedded("test.toml", "".as_ref(), scene);
    let scene = Scene::read(&document, "test").expect("a good scene");
    let (model, mut state, mut work) = scene.build().expect("a good model");
    let options = StepOptions::with_vertices(usize::MAX);
    let pose = scene.tools[0].pose.expect("a place");
    let sample = |shift: Vector3<f64>, turn: Vector3<f64>| ToolSample {
        id: scene.tools[0].id,
        position_m: (Vector3::from(pose.position_m) + shift).into(),
        orientation: UnitQuaternion::from_scaled_axis(turn).coords.into(),
        velocity_m_per_s: [0.0; 3],
        console_time_us: 0,
    };
    let none = Vector3::zeros();
    let mut go = |state: &mut State, shift, turn| {
        let report = step(&model, state, &[sample(shift, turn)], &options, &mut work);
        assert_eq!(report.status.name(), "ok");
        report
    };
    let mut report = go(&mut state, none, none);
    for _ in 0..3 {
        report = go(&mut state, none, none);
    }
    let contact = report.contacts()[0];
    let scales = Vector6::new(1.0, 1.0, 1.0, length_m, length_m, length_m);
    let (mut error, mut largest) = (Matrix6::zeros(), 0.0f64);
    for pose in 0..6 {
        let by = Vector3::ith(pose % 3, DIFFERENCE);
        let moved = |sign: f64| match pose {
            0..3 => (by * sign, none),
            _ => (none, by * sign),
        };
        let [ahead, behind] = [1.0, -1.0].map(|sign| {
            let (shift, turn) = moved(sign);
            Vector6::from(go(&mut state.clone(), shift, turn).contacts()[0].wrench)
        });
        let slope = (ahead - behind) / (2.0 * DIFFERENCE);
        for row in 0..6 {
            let scale = scales[row] * scales[pose];
            largest = largest.max((slope[row] / scale).abs());
            error[(row, pose)] = (contact.tangent[row][pose] - slope[row]) / scale;
        }
    }
    (report, error.amax() / largest)
}
