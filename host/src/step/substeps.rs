//! The way of needles, threads and tools to where a step has them go: in pieces, a balance at the end of each.
//!
//! Entry point: [`follow`].

use super::balance::Balance;
use super::report::Status;
use super::targets::{EDGE_PIECES, Targets};
use crate::model::Model;
use nalgebra::Vector3;

/// Pieces that one step follows.
const MAX_PIECES: u32 = 32;
/// The same of tools alone on tissue that is not linear: a pass has the tissue as it was at its beginning, and a tool that went far
/// in one would feel what linear tissue gives.
const MAX_PIECES_OF_A_PASS: u32 = 4;
/// Times that a piece without balance is halved before the step gives up.
const MAX_HALVINGS: i32 = 3;

/// Takes what is held to its targets in pieces.
pub(super) fn follow(model: &Model, balance: &mut Balance, targets: &Targets) -> Status {
    if let Err(status) = balance.begin() {
        return status;
    }
    let sources = balance.sources;
    let targets = &targets.on_leashes(balance);
    let lead_out = |balance: &Balance| {
        let contains = |at: &Vector3<f64>| model.contains(at);
        sources.tools.are_free(&targets.tools, contains)
            && balance.state.tools.lead_out(&sources.tools, &targets.tools)
    };
    let tools_alone = !sources.tools.is_empty() && !sources.reach_inside();
    let most = match tools_alone && !model.body.is_linear() {
        true => MAX_PIECES_OF_A_PASS,
        false => MAX_PIECES,
    };
    let mut halvings = 0;
    let mut done = 0.0;
    loop {
        let ends = targets.with_free(balance.state, done);
        let share = ends.share(sources, balance.state);
        if !share.is_finite() {
            return Status::NotFinite;
        }
        let free_m = EDGE_PIECES * sources.piece_m;
        let whole = share.min(balance.share_to_boundary(&ends.needles, free_m));
        let share = whole * 0.5f64.powi(halvings);
        balance.report.substeps += 1;
        let found = balance.to(&ends.part_way(balance.state, share));
        let is_found = found.is_ok();
        match found {
            Ok(()) if balance.slipped_in(model, share >= 1.0).is_some() => return Status::Inside,
            Ok(()) if share >= 1.0 => return Status::Ok,
            Ok(()) => {
                halvings = 0;
                done += share * (1.0 - done);
            }
            // Between tools the way counts: its end may be on their other side.
            Err(Status::NotConverged) if !sources.tools.is_empty() && halvings < MAX_HALVINGS => {
                halvings += 1;
            }
            // Where the way leads through what has no balance, its end may have one: that it can be left again.
            Err(Status::NotConverged | Status::TooManyRows)
                if share < 1.0 && sources.tools.is_empty() =>
            {
                return jump(model, balance, &ends, whole * f64::from(MAX_PIECES));
            }
            // The way there could not be followed, but it leads out, and nothing is touched at its end: let go.
            Err(Status::NotConverged | Status::TooManyRows) if lead_out(balance) => {
                balance.state.tools.let_go();
                return jump(model, balance, &ends, 1.0);
            }
            Err(status) => return status,
        }
        if balance.report.substeps >= most {
            if lead_out(balance) {
                balance.state.tools.let_go();
                return jump(model, balance, &ends, 1.0);
            }
            if !is_found {
                // The rows are those of the solve that failed: those of the last balance are found again, where it was.
                return jump(model, balance, &ends, 0.0);
            }
            return ended(model, balance, Status::Behind);
        }
    }
}

/// Balances at the end of a way that was not followed, or after a `share` of it, if that is less.
fn jump(model: &Model, balance: &mut Balance, ends: &Targets, share: f64) -> Status {
    match balance.to(&ends.part_way(balance.state, share)) {
        Ok(()) if share < 1.0 => ended(model, balance, Status::Behind),
        Ok(()) => ended(model, balance, Status::Ok),
        Err(status) => status,
    }
}

/// Ends a way with this status, unless a tool is in the tissue there.
fn ended(model: &Model, balance: &mut Balance, status: Status) -> Status {
    match balance.slipped_in(model, true) {
        Some(_) => Status::Inside,
        None => status,
    }
}
