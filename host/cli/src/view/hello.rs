//! What a page is told of a session before it shows anything of it.
//!
//! Entry point: [`hello`].

use serde_json::{Map, Value, json};
use sutura_host::picture::{Scalar, describe_needles, describe_threads, describe_tools, statuses};
use sutura_host::scene::Scene;
use sutura_host::session::{Plan, fault_words};
use sutura_host::step::Stages;
use sutura_shared::wire::faults;
use sutura_shared::wire::validate::name;

/// What scenes and plans do not say of a session.
#[derive(Clone, Debug, Default)]
pub struct Kind<'a> {
    /// `live` or `recording`.
    pub source: &'a str,
    /// `lockstep` or `real-time`.
    pub pace: &'a str,
    /// How the console is reached.
    pub console: &'a str,
    /// Whether it has motors.
    pub motors: bool,
    /// Commands that work.
    pub commands: Vec<&'static str>,
    /// Whether there are stresses and pressures.
    pub has_model: bool,
    /// Scenes to choose from.
    pub scenes: Vec<String>,
    /// Tissues to choose from.
    pub tissues: Vec<String>,
    /// Settings that can be changed: name, unit, value, least, largest, step.
    pub settings: Vec<Value>,
}

/// The session's part of `hello`.
pub fn hello(scene: &Scene, plan: &Plan, kind: &Kind<'_>) -> Map<String, Value> {
    let points = scene.mesh.points_m();
    let ends = |choose: fn(f64, f64) -> f64, from: f64| {
        let fold = |axis: usize| {
            points
                .iter()
                .fold(from, |end, point| choose(end, point[axis]))
        };
        [fold(0), fold(1), fold(2)]
    };
    let scalars = Scalar::ALL.iter().map(|scalar| {
        let (name, unit, signed) = scalar.words();
        // Numbers follow from places: what this tissue has not is left at its place.
        let is_there = kind.has_model || !scalar.needs_model();
        json!({"name": name, "unit": unit, "signed": signed, "available": is_there})
    });
    let fixes: Map<String, Value> = faults::NAMES
        .iter()
        .map(|(bit, name)| {
            let (message, help) = fault_words(*bit);
            (
                (*name).to_owned(),
                json!({"message": message, "help": help}),
            )
        })
        .collect();
    let said = json!({
        "source": kind.source,
        "pace": kind.pace,
        "scene": scene.name,
        "tissue": scene.tissue.to_string(),
        "rendering": plan.rendering.word(),
        "device": name(&plan.device.name).unwrap_or_default(),
        "console": kind.console,
        "tick_hz": plan.tick_hz,
        "host_hz": plan.host_hz,
        "board_rows_hz": scene.device.and_then(|device| device.board_rows_hz),
        "horizon_ms": plan.horizon_us.map(|us| 1e-3 * f64::from(us)),
        "nodes": points.len(),
        "cells": scene.mesh.cells().len(),
        "bounds_m": [ends(f64::min, f64::INFINITY), ends(f64::max, f64::NEG_INFINITY)],
        "motors": kind.motors,
        "do": kind.commands,
        "mode": "idle",
        "faults": [],
        "stages": Stages::default().named().map(|(name, _)| name),
        "statuses": statuses(),
        "scalars": scalars.collect::<Vec<_>>(),
        "tools": describe_tools(scene),
        "needles": describe_needles(scene),
        "threads": describe_threads(scene),
        "settings": kind.settings,
        "scenes": kind.scenes,
        "tissues": kind.tissues,
        "fixes": fixes,
        "time_line": null,
    });
    match said {
        Value::Object(said) => said,
        _ => Map::new(),
    }
}
