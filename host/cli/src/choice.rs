//! `--budget-ms` and `tissue = "auto"`: measures, chooses, and says what and why.
//!
//! Entry point: [`settle`].

use crate::failure::{Cause, Failure};
use crate::run::RunArgs;
use indicatif::ProgressBar;
use std::time::{Duration, Instant};
use sutura_host::scene::{Scene, Tissue};
use sutura_host::session::Plan;
use sutura_study::choice::{Asked, Candidate, Chosen, SAFE_SHARE, choose, measure};

/// Settles which tissue the session of a plan has, where the scene or the budget leaves that open.
///
/// # Errors
/// No tissue model runs on the scene.
pub fn settle(args: &RunArgs, scene: &mut Scene, plan: &Plan) -> Result<Option<Chosen>, Failure> {
    let is_auto = args.tissue.unwrap_or(scene.tissue) == Tissue::Auto;
    let for_budget = args.budget_ms.is_some() && args.tissue.is_none() && scene.needles.is_empty();
    if !is_auto && !for_budget {
        return Ok(None);
    }
    let budget_ms = args.budget_ms.unwrap_or(1e3 / plan.host_hz);
    let asked = Asked {
        plan,
        budget_us: 1e3 * budget_ms,
        rendering: args.rendering.map(Into::into),
    };
    let began = Instant::now();
    // Hidden by itself where stderr is no terminal.
    let progress = ProgressBar::new_spinner();
    progress.enable_steady_tick(Duration::from_millis(100));
    let found = measure(scene, &asked, &mut |what| {
        progress.set_message(format!("measuring {what}"));
    });
    progress.finish_and_clear();
    let calibration_s = began.elapsed().as_secs_f64();
    let candidates = match found {
        Ok(candidates) => candidates,
        Err(why) => {
            if scene.tissue == Tissue::Auto {
                scene.tissue = Tissue::Linear;
            }
            note!(
                "{} tissue is taken without a measurement: the scene cannot be measured on: {why}",
                scene.tissue.word()
            );
            return Ok(None);
        }
    };
    let chosen = choose(&candidates, asked.budget_us);
    let Some((best, taken, holds_budget)) =
        chosen.and_then(|(taken, holds)| Some((candidates.get(taken)?.clone(), taken, holds)))
    else {
        let why = |candidate: &Candidate| format!("{}: {}", candidate.tissue, candidate.note);
        let whys: Vec<_> = candidates.iter().map(why).collect();
        let message = format!(
            "no tissue model can be run on this scene: {}",
            whys.join("; ")
        );
        let help = "see what `sutura scene check` says of it, or fix a model with --tissue";
        return Err(Failure::say(Cause::Failed, message, help));
    };
    let tissue = Tissue::named(&best.tissue).map_err(|message| {
        Failure::say(Cause::Failed, message, "this is a defect: please report it")
    })?;
    scene.tissue = tissue.instead_of(scene.tissue);
    note!(
        "a step may take {budget_ms:.3} ms; {} models and settings were compared under one law, {}, in {calibration_s:.1} s:",
        candidates
            .iter()
            .filter(|each| each.step_us.is_some())
            .count(),
        scene.contact_law().words()
    );
    table(&candidates, taken);
    if holds_budget {
        note!("taken: --tissue \"{}\"", best.tissue);
    } else {
        note!(
            "taken: --tissue \"{}\", the fastest: none was compared and kept its slowest steps within {:.0} % of the budget",
            best.tissue,
            100.0 * SAFE_SHARE
        );
    }
    Ok(Some(Chosen {
        model: best.model,
        setting: best.setting,
        step_us: best.step_us,
        error: best.error,
        contact: scene.contact_law(),
        budget_ms,
        holds_budget,
        calibration_s,
        candidates,
    }))
}

fn table(candidates: &[Candidate], taken: usize) {
    note!(
        "  {:<58} {:>10} {:>10} {:>8} {:>8}",
        "",
        "p50 us",
        "p99 us",
        "force",
        "places"
    );
    for (index, candidate) in candidates.iter().enumerate() {
        let time = |us: Option<f64>| us.map_or_else(|| "-".to_owned(), |us| format!("{us:.0}"));
        let share = |error: Option<f64>| {
            error.map_or_else(|| "-".to_owned(), |error| format!("{:.2} %", 100.0 * error))
        };
        let mark = if index == taken { ">" } else { " " };
        note!(
            "{mark} {:<58} {:>10} {:>10} {:>8} {:>8}  {}",
            candidate.tissue,
            time(candidate.step_us.map(|us| us.p50)),
            time(candidate.step_us.map(|us| us.p99)),
            share(candidate.error),
            share(candidate.displacement_error),
            candidate.note
        );
    }
}
