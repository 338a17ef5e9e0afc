//! A straight needle through two slabs.

use super::bench::*;
use nalgebra::Vector3;
use sutura_host::fidelity::hand::Motion;

/// A named hand, with the tip at the skin where it has 0.
fn named(motion: Motion) -> impl Fn(f64) -> Vector3<f64> {
    move |time_s| Vector3::new(0.0011, 0.0007, 0.052) + Vector3::from(motion.at(time_s))
}

/// Pushed on while it is pressed to and fro by 10 mm at 1 Hz, and back.
fn through(time_s: f64) -> Vector3<f64> {
    let drift = 0.012 * (time_s.min(3.5) - (time_s - 3.5).max(0.0));
    let press = 0.005 * (1.0 - (std::f64::consts::TAU * time_s).cos());
    Vector3::new(0.0011, 0.0007, 0.06 - drift - press)
}

/// 1 mm at 8 Hz on a slow push.
fn shaking(time_s: f64) -> Vector3<f64> {
    let shake = 0.0005 * (std::f64::consts::TAU * 8.0 * time_s).sin();
    Vector3::new(0.0011, 0.0007, 0.055 - 0.006 * time_s + shake)
}

/// In at 0.1 m/s and back, again and again, deeper every time.
fn stabs(time_s: f64) -> Vector3<f64> {
    let depth = 0.007 + 0.004 * time_s;
    let back = (2.0 * (time_s * 2.0).fract() - 1.0).abs();
    let smooth = 0.5 - 0.5 * (std::f64::consts::PI * (1.0 - back)).cos();
    Vector3::new(0.0011, 0.0007, 0.06 - depth * smooth - 0.004 * time_s)
}

#[test]
#[ignore = "a table"]
fn figures() {
    // Tissue that sticks better than it slides is another tissue with other steps.
    let sticks = "static_friction_n_per_m = 30.0";
    let scene = scene(
        "needle-slabs.toml",
        sticks,
        "static_friction_n_per_m = 25.0",
    );
    let hands: [Case; 6] = [
        ("presses", &named(Motion::Presses), 0, 4000),
        ("taps", &named(Motion::Taps), 0, 4000),
        ("tremor", &named(Motion::Tremor), 0, 3000),
        ("through", &through, 0, 6000),
        ("shaking", &shaking, 0, 5000),
        ("stabs", &stabs, 0, 4000),
    ];
    table(&scene, &hands);
}

/// Presses at 60 Hz, one period late: what is felt, and when the boundary gives way.
#[test]
fn the_console_goes_on_as_the_tissue_does() {
    let sticks = "static_friction_n_per_m = 30.0";
    let scene = scene(
        "needle-slabs.toml",
        sticks,
        "static_friction_n_per_m = 25.0",
    );
    let hand = named(Motion::Presses);
    let truth = truth(&scene, &hand, 0, 2000);
    let of = |rendering| {
        run(
            &scene,
            &hand,
            &truth,
            0,
            60.0,
            rendering,
            None,
            |_, _, _| {},
        )
    };
    let (local, tangent) = (of(Rendering::Local), of(Rendering::Tangent));
    println!("{local:?} {tangent:?}");
    assert_eq!(local.punctures, 2);
    assert!(local.late_max_ms <= 8.0, "{local:?}");
    // Measured: 3.5 % and 12.3 %.
    assert!(local.rms <= 0.045 && local.peak <= 0.15, "{local:?}");
    assert!(local.rms < 0.3 * tangent.rms, "{local:?} {tangent:?}");
}
