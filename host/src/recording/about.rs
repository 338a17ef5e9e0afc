//! What a recording says of itself: who made it, on what, and what the session was to be.
//!
//! Entry point: [`About`]; in the file it is one metadata record of words, so that any program shows it.

use crate::scene::LONGEST_S;
use crate::session::Plan;
use std::collections::BTreeMap;
use sutura_shared::control::{CODE, TICK_HZ};
use sutura_shared::wire::Message;
use sutura_shared::wire::message::Simulate;
use sutura_shared::wire::{PROTOCOL_VERSION, SCHEMA_HASH};

/// Version of what this program makes of the container.
const LAYOUT: &str = "1";
/// Name of the metadata record.
pub(super) const ABOUT: &str = "sutura";
/// Its word for the console's code; recordings of programs before it do not have it.
pub(super) const CONSOLE_CODE: &str = "console_code";

/// Where in a session a recording begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begins {
    /// With the session.
    Session,
    /// Later: what was before is not in it.
    Later,
}

/// What a recording says of itself.
#[derive(Clone, Debug, PartialEq)]
pub struct About {
    /// Version of the program.
    pub program: String,
    /// Which build of it; the same build gives the same bits.
    pub build: String,
    /// Instructions that the solver's linear algebra uses on this machine, found out at run time.
    pub simd: String,
    /// Architecture and system.
    pub target: String,
    /// Version of the wire protocol.
    pub protocol: u8,
    /// Hash of the messages' layouts.
    pub schema_hash: u64,
    /// Code of the console, as far as this program knows it: see [`CODE`].
    pub console_code: u32,
    /// Where it begins.
    pub begins: Begins,
    /// How the console was reached.
    pub console: String,
    /// Whether host and console went tick by tick.
    pub lockstep: bool,
    /// Whether a thread computed the solver's columns, which come when they come.
    pub worker: bool,
    /// Whether factors of turning tissue were renewed beside the steps; older programs made them in the step.
    pub renews: bool,
    /// Tissue model that the scene was run with.
    pub tissue: String,
    /// The session.
    pub plan: Plan,
}

/// Instructions that the solver's linear algebra uses on this machine.
pub fn simd_level() -> String {
    // As `V3(...)`: the word is all that matters.
    let level = format!("{:?}", pulp::Arch::new());
    let end = level.find(|c: char| !c.is_alphanumeric());
    level[..end.unwrap_or(level.len())].to_lowercase()
}

impl About {
    /// Of a session with this program on this machine. `build` names the program's build.
    pub fn here(build: String, plan: &Plan, tissue: &str) -> About {
        About {
            program: env!("CARGO_PKG_VERSION").to_owned(),
            build,
            simd: simd_level(),
            target: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
            protocol: PROTOCOL_VERSION,
            schema_hash: SCHEMA_HASH,
            console_code: CODE,
            begins: Begins::Session,
            console: String::new(),
            lockstep: false,
            worker: false,
            renews: true,
            tissue: tissue.to_owned(),
            plan: *plan,
        }
    }

    /// Whether a solver here gives the same bits as the one that was recorded.
    pub fn same_bits(&self, here: &About) -> bool {
        (&self.build, &self.simd, &self.target) == (&here.build, &here.simd, &here.target)
    }

    /// In the words of the file.
    pub fn words(&self) -> BTreeMap<String, String> {
        let begins = match self.begins {
            Begins::Session => "session",
            Begins::Later => "later",
        };
        let words = [
            ("layout", LAYOUT.to_owned()),
            ("program", self.program.clone()),
            ("build", self.build.clone()),
            ("simd", self.simd.clone()),
            ("target", self.target.clone()),
            ("protocol", self.protocol.to_string()),
            ("schema_hash", format!("{:016x}", self.schema_hash)),
            (CONSOLE_CODE, self.console_code.to_string()),
            ("begins", begins.to_owned()),
            ("console", self.console.clone()),
            ("lockstep", self.lockstep.to_string()),
            ("worker", self.worker.to_string()),
            ("renews", self.renews.to_string()),
            ("tissue", self.tissue.clone()),
            // Numbers are written so that they are read back to the bit.
            (
                "plan",
                serde_json::to_string(&self.plan).unwrap_or_default(),
            ),
        ];
        words
            .map(|(key, word)| (key.to_owned(), word))
            .into_iter()
            .collect()
    }

    /// From the words of a file, or what is wrong with them.
    pub(super) fn from_words(words: &BTreeMap<String, String>) -> Result<About, String> {
        let word = |key: &str| {
            let word = words.get(key).cloned();
            word.ok_or_else(|| format!("its metadata lack `{key}`"))
        };
        let layout = word("layout")?;
        if layout != LAYOUT {
            return Err(format!(
                "its layout is {layout}, this program reads {LAYOUT}"
            ));
        }
        let wrong = |key: &str| format!("`{key}` in its metadata cannot be read");
        let truth = |key: &str| word(key)?.parse().map_err(|_| wrong(key));
        let begins = match word("begins")?.as_str() {
            "session" => Begins::Session,
            "later" => Begins::Later,
            _ => return Err(wrong("begins")),
        };
        Ok(About {
            program: word("program")?,
            build: word("build")?,
            simd: word("simd")?,
            target: word("target")?,
            protocol: word("protocol")?.parse().map_err(|_| wrong("protocol"))?,
            schema_hash: u64::from_str_radix(&word("schema_hash")?, 16)
                .map_err(|_| wrong("schema_hash"))?,
            console_code: word(CONSOLE_CODE)?
                .parse()
                .map_err(|_| wrong(CONSOLE_CODE))?,
            begins,
            console: word("console")?,
            lockstep: truth("lockstep")?,
            worker: truth("worker")?,
            // Older programs do not say.
            renews: words.contains_key("renews") && truth("renews")?,
            tissue: word("tissue")?,
            plan: read_plan(&word("plan")?)?,
        })
    }
}

/// A plan that a session could have had.
fn read_plan(text: &str) -> Result<Plan, String> {
    let plan: Plan = serde_json::from_str(text).map_err(|error| {
        format!("`plan` in its metadata is not of this program's form ({error})")
    })?;
    let numbers = [
        ("host_hz", plan.host_hz, 1.0..=f64::from(TICK_HZ)),
        ("seconds", plan.seconds, 0.0..=LONGEST_S),
        ("line_bytes_per_s", plan.line_bytes_per_s, 0.0..=1e12),
    ];
    for (name, value, range) in numbers {
        if !range.contains(&value) {
            return Err(format!("`{name}` of the plan in its metadata is {value}"));
        }
    }
    let orders = [Simulate::Device(plan.device), Simulate::Hand(plan.hand)];
    let checked = orders.iter().try_for_each(Simulate::check);
    checked.map_err(|reject| format!("device or hand of the plan in its metadata: {reject}"))?;
    Ok(plan)
}
