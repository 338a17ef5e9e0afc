//! The scene that the command has by itself, where there is no checkout.

use crate::support::{Ran, sutura, sutura_in};
use serde_json::Value;

const SHORT: [&str; 6] = ["run", "--lockstep", "--seconds", "0.05", "--format", "json"];

fn hash(ran: &Ran) -> String {
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let summary: Value = serde_json::from_str(&ran.stdout).expect("one JSON object");
    assert_eq!(summary["ticks"], 50);
    summary["trace_hash"].as_str().expect("a hash").to_owned()
}

/// In an empty directory the copy inside the program runs, and it is the scene that ships: same bits in,
/// same bits out.
#[test]
fn the_default_scene_runs_anywhere_and_is_the_one_that_ships() {
    let empty = tempfile::tempdir().expect("a directory");
    assert_eq!(
        hash(&sutura_in(empty.path(), &SHORT)),
        hash(&sutura(&SHORT))
    );
}
