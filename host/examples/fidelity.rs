//! Errors and largest stable stiffness on the point of tissue, as a table.

use sutura_host::fidelity::hand::{Grasp, Motion};
use sutura_host::fidelity::link::LinkSpec;
use sutura_host::fidelity::measure::errors;
use sutura_host::fidelity::plant::Mechanics;
use sutura_host::fidelity::run::{Host, Setup, run, truth_along};
use sutura_host::fidelity::scenes::Scene;
use sutura_host::fidelity::scenes::palpation::Palpation;
use sutura_host::fidelity::scenes::point::Point;
use sutura_host::fidelity::stiffest::{Search, stiffest};
use sutura_shared::control::{Guards, Rendering, Tuning};

const SECONDS: f64 = 4.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let only = std::env::args().nth(1).unwrap_or_default();
    let point = Point::TISSUE;
    let palpation = Palpation::load()?;
    let scenes: [&dyn Scene; 2] = [&point, &palpation];
    let all = Tuning::default();
    let of = |rendering| Tuning { rendering, ..all };
    let renderings = [
        ("full", of(Rendering::Hold)),
        ("hold", of(Rendering::Hold)),
        ("linear-time", of(Rendering::LinearTime)),
        ("tangent", of(Rendering::Tangent)),
        ("rows", of(Rendering::Rows)),
        (
            "tangent no guards",
            Tuning {
                rendering: Rendering::Tangent,
                guards: NONE,
            },
        ),
    ];
    let late = |hz: f64| (format!("{hz:.0} Hz"), Host::Late(LinkSpec::ideal(hz)));
    println!("open loop: rms/peak/step/other step % (sampled rms) least energy mJ");
    for (scene, motion) in scenes
        .iter()
        .flat_map(|scene| Motion::NAMED.map(|m| (*scene, m)))
    {
        if only.starts_with("closed") {
            continue;
        }
        let truth = truth_along(scene, motion, SECONDS);
        for (name, tuning) in renderings {
            for (rate, host) in [late(30.0), late(60.0), late(100.0), late(1000.0)] {
                let label = format!("open {} {} {name} {rate}", scene.name(), motion.name());
                let host = if name == "full" { Host::Full } else { host };
                if !label.contains(&only) || (name == "full" && rate != "30 Hz") {
                    continue;
                }
                let record = run(&Setup {
                    scene,
                    motion,
                    grasp: Grasp::Rigid,
                    mechanics: Mechanics::LIGHT,
                    tuning,
                    host,
                    tangent_scale: 1.0,
                    most_rows: 24,
                    seconds: SECONDS,
                    knock: None,
                    truth: Some(&truth),
                })?;
                let e = errors(&record);
                println!(
                    "{label:44} {:6.2} {:6.2} {:6.2} {:6.2}  ({:6.2}) peak at {:.3} s, largest {:.2} N, energy {:7.3} mJ",
                    e.rms_pct,
                    e.peak_pct,
                    e.step_pct,
                    e.other_step_pct,
                    e.rms_pct_sampled,
                    e.peak_at_s,
                    e.largest_n,
                    record.least_energy_j * 1e3
                );
            }
        }
    }
    println!("closed loop: largest stable stiffness N/m, least force ratio, least energy mJ");
    for (name, tuning) in renderings {
        for (rate, host) in [late(30.0), late(60.0), late(100.0), late(1000.0)] {
            for scale in [1.0, 0.75, 1.25, 0.5, 2.0] {
                let label = format!("closed {name} {rate} x{scale}");
                let host = if name == "full" { Host::Full } else { host };
                if !label.contains(&only)
                    || (matches!(name, "hold" | "full" | "linear-time") && scale != 1.0)
                    || (name == "full" && rate != "30 Hz")
                {
                    continue;
                }
                let found = stiffest(&Search {
                    tuning,
                    host,
                    tangent_scale: scale,
                    mechanics: Mechanics::LIGHT,
                })?;
                println!(
                    "{label:44} {:8.0} {:6.3} {:8.3}",
                    found.k_max_n_per_m,
                    found.least_force_ratio,
                    found.least_energy_j * 1e3
                );
            }
        }
    }
    Ok(())
}

const NONE: Guards = Guards {
    blend: false,
    trust: false,
    lead: false,
    tank: false,
    damping: false,
    horizon: false,
    force: false,
    slew: false,
    power: false,
    overspeed: false,
    residual: false,
};
