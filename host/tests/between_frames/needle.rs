//! A straight needle through two slabs.

use super::bench::*;
use nalgebra::Vector3;

/// Pushed on while it is pressed to and fro by 10 mm at 1 Hz, and back.
fn presses(time_s: f64) -> Vector3<f64> {
    let drift = 0.012 * (time_s.min(3.5) - (time_s - 3.5).max(0.0));
    let press = 0.005 * (1.0 - (std::f64::consts::TAU * time_s).cos());
    Vector3::new(0.0011, 0.0007, 0.06 - drift - press)
}

/// 1 mm at 8 Hz on a slow push.
fn tremor(time_s: f64) -> Vector3<f64> {
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
    let scene = scene("needle-slabs.toml");
    let hands: [(&str, Hand, u64); 3] = [
        ("presses", &presses, 6000),
        ("tremor", &tremor, 5000),
        ("stabs", &stabs, 4000),
    ];
    for (name, hand, ticks) in hands {
        let truth = truth(&scene, hand, ticks);
        let dir = std::env::var("TRACES").ok();
        if let Some(dir) = &dir {
            let lines = truth.iter().enumerate().map(|(tick, (force, punctures))| {
                let at = hand(1e-3 * tick as f64);
                format!(
                    "{tick} {} {} {} {} {} {} {punctures}\n",
                    at.x, at.y, at.z, force.x, force.y, force.z
                )
            });
            std::fs::write(format!("{dir}/{name}-truth"), lines.collect::<String>()).unwrap();
        }
        for host_hz in [30.0, 60.0, 100.0, 200.0] {
            for rendering in [Rendering::Hold, Rendering::Tangent, Rendering::Local] {
                let mut lines = String::new();
                let found = run(
                    &scene,
                    hand,
                    &truth,
                    host_hz,
                    rendering,
                    |tick, should: Vector3<f64>, is: Vector3<f64>| {
                        lines += &format!("{tick} {} {}\n", should.z, is.z);
                    },
                );
                if let Some(dir) = &dir {
                    std::fs::write(format!("{dir}/{name}-{host_hz}-{rendering:?}"), lines).unwrap();
                }
                println!(
                    "{name:8} {host_hz:5} Hz {rendering:8?} rms {:6.2} % peak {:6.2} % (at {:.3} s) step {:6.2} %  {} punctures late p95 {:.1} max {:.1} ms  of {:.3} N",
                    100.0 * found.rms,
                    100.0 * found.peak,
                    found.peak_at_s,
                    100.0 * found.step,
                    found.punctures,
                    found.late_p95_ms,
                    found.late_max_ms,
                    found.largest_n
                );
            }
        }
    }
}
