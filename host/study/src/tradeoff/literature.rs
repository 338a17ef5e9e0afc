//! Figures that others printed, on their machines. Not measured here.
//!
//! Entry point: [`FIGURES`].

use schemars::JsonSchema;
use serde::Serialize;

/// One printed figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Figure {
    /// Who printed it.
    pub source: &'static str,
    /// The case of ours that comes nearest, or none.
    pub case: &'static str,
    /// What it says.
    pub what: &'static str,
    /// How much.
    pub value: f64,
    /// Of what.
    pub unit: &'static str,
}

const fn figure(
    source: &'static str,
    case: &'static str,
    what: &'static str,
    value: f64,
    unit: &'static str,
) -> Figure {
    Figure {
        source,
        case,
        what,
        value,
        unit,
    }
}

const EBM: &str = "zhang-2017, energy balance against ABAQUS";
const PEERS: &str = "peers on 1,650 nodes, 5,844 cells, 2 shared cores (EPYC)";

/// What is printed beside the tables.
pub const FIGURES: [Figure; 18] = [
    figure(
        EBM,
        "beam-tension",
        "largest error of u_x, 20 iterations",
        9.112,
        "%",
    ),
    figure(
        EBM,
        "beam-tension",
        "largest error of u_x, 100 iterations",
        2.892,
        "%",
    ),
    figure(
        EBM,
        "cylinder-compressed",
        "largest error of u_x on the line",
        7.721,
        "%",
    ),
    figure(
        EBM,
        "cylinder-stretched",
        "largest error of u_x on the line",
        7.766,
        "%",
    ),
    figure(
        EBM,
        "cube-sheared",
        "largest error of u_z on the line",
        7.945,
        "%",
    ),
    figure(
        "zhang-2017, ChainMail against CATIA",
        "",
        "mean displacement error of 1.08 mm",
        9.7,
        "%",
    ),
    figure(
        "zhang-2017, energy balance",
        "",
        "cells at 1 kHz, isotropic",
        500.0,
        "cells",
    ),
    figure(
        "zhang-2017, energy balance",
        "",
        "cells at 1 kHz, with fibres",
        200.0,
        "cells",
    ),
    figure(
        "zhang-2017, ChainMail",
        "",
        "moved elements at 1 kHz",
        4_100.0,
        "elements",
    ),
    figure(PEERS, "", "SOFA corotational, 60 rows, a step", 49.7, "ms"),
    figure(
        PEERS,
        "",
        "SOFA fast corotational, 60 rows, a step",
        43.8,
        "ms",
    ),
    figure(
        PEERS,
        "",
        "younes-2021 (own machine, with rendering), a step",
        30.0,
        "ms",
    ),
    figure(PEERS, "", "MuJoCo flex, a bare step", 7.5, "ms"),
    figure(
        PEERS,
        "",
        "NiftySim explicit, a bare step of 0.17 ms",
        0.43,
        "ms",
    ),
    figure(
        PEERS,
        "",
        "position-based FEM, 5 iterations, a bare step",
        2.0,
        "ms",
    ),
    figure(
        PEERS,
        "",
        "position-based shape matching, a bare step",
        7.5,
        "ms",
    ),
    figure(PEERS, "", "XPBD, a bare step", 2.5, "ms"),
    figure(
        PEERS,
        "",
        "Newton/Warp VBD, 10 iterations, a bare step",
        22.0,
        "ms",
    ),
];
