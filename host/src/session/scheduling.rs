//! What a session's threads got of the system, for its summary.

use crate::scheduling::Granted;
use schemars::JsonSchema;
use serde::Serialize;

/// `scheduling` in a session's summary. Each is `real-time`, `ordinary` or `not-asked`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, JsonSchema)]
pub struct Scheduling {
    /// The solver's thread.
    pub solver: &'static str,
    /// The link's threads: `real-time` if both are.
    pub link: &'static str,
    /// The console's thread; none if the console is not in this process.
    pub console: Option<&'static str>,
    /// Whether this process's memory stayed in RAM.
    pub memory_locked: bool,
    /// How often the solver gave way to other programs, because it did not rest.
    pub gave_way: u64,
}

impl Scheduling {
    /// What solver and link got.
    pub fn new(solver: Granted, gave_way: u64, link: Granted, memory_locked: bool) -> Self {
        Scheduling {
            solver: solver.word(),
            link: link.word(),
            console: None,
            memory_locked,
            gave_way,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_the_summary_s() {
        let scheduling = Scheduling::new(Granted::RealTime, 2, Granted::Ordinary, true);
        let json = serde_json::to_value(scheduling).expect("JSON");
        let expected = serde_json::json!({
            "solver": "real-time", "link": "ordinary", "console": null, "memory_locked": true, "gave_way": 2,
        });
        assert_eq!(json, expected);
        assert_eq!(Granted::default().word(), "not-asked");
    }
}
