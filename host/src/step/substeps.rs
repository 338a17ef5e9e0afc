//! The way of needles, threads and tools to where a step has them go: in pieces, a balance at the end of each.
//!
//! Entry point: [`follow`].

use super::balance::Balance;
use super::report::Status;
use super::targets::Targets;
use crate::model::Model;

/// Pieces that one step follows.
const MAX_PIECES: u32 = 32;
/// Times that a piece without balance is halved before the step gives up.
const MAX_HALVINGS: i32 = 3;

/// Takes what is held to its targets in pieces.
pub(super) fn follow(model: &Model, balance: &mut Balance, targets: &Targets) -> Status {
    if let Err(status) = balance.begin() {
        return status;
    }
    let sources = balance.sources;
    let targets = &targets.on_leashes(balance);
    let are_free = || {
        sources
            .tools
            .are_free(&targets.tools, |at| model.contains(at))
    };
    let mut halvings = 0;
    let mut done = 0.0;
    loop {
        let ends = targets.with_free(balance.state, done);
        let share = ends.share(sources, balance.state);
        if !share.is_finite() {
            return Status::NotFinite;
        }
        let share = share * 0.5f64.powi(halvings);
        balance.report.substeps += 1;
        match balance.to(&ends.part_way(balance.state, share)) {
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
                return jump(balance, &ends);
            }
            // The way there could not be followed, but nothing is touched at its end: let go.
            Err(Status::NotConverged | Status::TooManyRows) if are_free() => {
                balance.state.tools.let_go();
                return jump(balance, &ends);
            }
            Err(status) => return status,
        }
        if balance.report.substeps >= MAX_PIECES {
            if are_free() {
                balance.state.tools.let_go();
                return jump(balance, &ends);
            }
            return Status::Behind;
        }
    }
}

/// A balance at the end of a way that was not followed.
fn jump(balance: &mut Balance, ends: &Targets) -> Status {
    match balance.to(ends) {
        Ok(()) => Status::Ok,
        Err(status) => status,
    }
}
