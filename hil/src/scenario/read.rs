//! From a scenario file to a [`Scenario`]: every number within its limits, or a complaint at its place.
//!
//! Entry points: [`Scenario::load`], [`Scenario::read`], [`built_in`].

use super::file::{ExpectSection, HostSection, Number, OrderSection, ScenarioFile};
use super::{ConsoleKind, Expect, HostSpec, Scenario, Ticks, World};
use std::path::Path;
use sutura_host::scene::{
    BUILT_IN_DEVICES, Document, SceneError, find_device, hand_script, nearest, read_device,
};
use sutura_host::session::mode_word;
use sutura_shared::simulated_console::Without;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command, Mode};
use toml::Spanned;

/// The scenarios that come with the project, relative to the checkout.
pub const SCENARIOS: &str = "hil/scenarios";

/// Longest scenario \[s\].
const LONGEST_S: f64 = 600.0;

/// All scenarios of the checkout that this was built from, by name.
///
/// # Errors
/// The first file that is wrong.
pub fn built_in() -> Result<Vec<Scenario>, SceneError> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    all_in(&here.join("scenarios"))
}

/// All scenarios of a folder, by name.
fn all_in(folder: &Path) -> Result<Vec<Scenario>, SceneError> {
    let unreadable = |source| SceneError::Unreadable {
        path: folder.to_owned(),
        source,
    };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path
            .extension()
            .is_some_and(|extension| extension == "toml")
        {
            paths.push(path);
        }
    }
    paths.sort();
    paths.iter().map(|path| Scenario::load_one(path)).collect()
}

impl Scenario {
    /// Reads a file, or all files of a folder.
    ///
    /// # Errors
    /// [`SceneError`] at the first thing that is wrong.
    pub fn load(path: &Path) -> Result<Vec<Scenario>, SceneError> {
        if path.is_dir() {
            all_in(path)
        } else {
            Ok(vec![Scenario::load_one(path)?])
        }
    }

    fn load_one(path: &Path) -> Result<Scenario, SceneError> {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        Scenario::read(&Document::read(path)?, &name)
    }

    /// Checks a scenario that is in memory.
    ///
    /// # Errors
    /// [`SceneError`] at the first thing that is wrong.
    pub fn read(document: &Document, name: &str) -> Result<Scenario, SceneError> {
        let file: ScenarioFile = document.parse()?;
        let c = Check(document);
        let seconds = c.within("seconds", &file.seconds, 0.01, LONGEST_S, "s")?;
        let ticks = (seconds * 1e3).round() as Ticks;
        let device = match &file.device {
            Some(device) => find_device(document, device)?.description,
            None => {
                let (name, text) = BUILT_IN_DEVICES[0];
                read_device(&Document::embedded(name, Path::new(""), text))?.description
            }
        };
        let hand = file
            .hand
            .as_ref()
            .map(|hand| hand_script(document, hand.get_ref(), &device))
            .transpose()?;
        let consoles = match &file.consoles {
            None => ConsoleKind::NAMES.map(|(_, kind)| kind).to_vec(),
            Some(list) => {
                let words = list.get_ref().iter();
                let kinds = words.map(|word| c.word("console", word, &ConsoleKind::NAMES));
                kinds.collect::<Result<_, _>>()?
            }
        };
        let faults = file
            .fault
            .iter()
            .map(|fault| c.fault(fault, ticks))
            .collect::<Result<Vec<_>, _>>()?;
        let orders = file.order.iter().map(|order| c.order(order, ticks));
        let mut mutant = Vec::new();
        for name in file.mutant.iter().flat_map(|mutant| mutant.off.get_ref()) {
            c.guard(name)?;
            mutant.push(name.get_ref().clone());
        }
        Ok(Scenario {
            name: name.to_owned(),
            about: file.about.into_inner(),
            ticks,
            seed: file.seed,
            device,
            consoles,
            host: c.host(&file.host)?,
            hand,
            orders: orders.collect::<Result<_, _>>()?,
            faults,
            expect: c.expect(&file.expect)?,
            mutant,
        })
    }
}

/// Checks with the document at hand.
pub(super) struct Check<'a>(pub(super) &'a Document);

impl Check<'_> {
    pub(super) fn within(
        &self,
        key: &str,
        value: &Number,
        least: f64,
        most: f64,
        unit: &str,
    ) -> Result<f64, SceneError> {
        let rule = format!("from {least} to {most} {unit}");
        let ok = |v: f64| (least..=most).contains(&v);
        self.0.number(
            key,
            value,
            rule.trim_end(),
            ok,
            "see the book: Hardware in the loop",
        )
    }

    /// Milliseconds, which are ticks.
    pub(super) fn time(&self, key: &str, value: &Number, least: f64) -> Result<Ticks, SceneError> {
        let most = LONGEST_S * 1e3;
        Ok(self.within(key, value, least, most, "ms")?.round() as Ticks)
    }

    pub(super) fn times<const N: usize>(
        &self,
        list: [(&str, &Option<Number>); N],
    ) -> Result<[Option<Ticks>; N], SceneError> {
        let mut all = [None; N];
        for (slot, (key, value)) in all.iter_mut().zip(list) {
            *slot = value.as_ref().map(|v| self.time(key, v, 0.0)).transpose()?;
        }
        Ok(all)
    }

    pub(super) fn share(&self, value: &Number) -> Result<f64, SceneError> {
        self.within("share", value, 0.0, 1.0, "")
    }

    pub(super) fn word<T: Copy>(
        &self,
        what: &str,
        word: &Spanned<String>,
        known: &[(&str, T)],
    ) -> Result<T, SceneError> {
        let said = word.get_ref().as_str();
        if let Some((_, found)) = known.iter().find(|(name, _)| *name == said) {
            return Ok(*found);
        }
        let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
        let all = names.iter().map(|name| format!("`{name}`"));
        let all = all.collect::<Vec<_>>().join(", ");
        let help = match nearest(said, &names) {
            Some(near) => format!("did you mean `{near}`? Known here: {all}"),
            None => format!("known here: {all}"),
        };
        let message = format!("unknown {what} `{said}`");
        Err(self
            .0
            .flaw(word.span(), message, format!("no such {what}"), Some(&help)))
    }

    fn guard(&self, name: &Spanned<String>) -> Result<(), SceneError> {
        if Without::default().switch_off(name.get_ref()) {
            return Ok(());
        }
        let message = format!("unknown guard `{}`", name.get_ref());
        let help =
            "guards of the control loop: see `Guards`; of the link: see `Checks`; both in the book";
        Err(self
            .0
            .flaw(name.span(), message, "no such guard", Some(help)))
    }

    fn host(&self, section: &HostSection) -> Result<HostSpec, SceneError> {
        let hz = self.within("hz", &section.hz, 1.0, 1000.0, "Hz")?;
        let number = |key, value: &Option<Number>, default: f64, most, unit| match value {
            Some(value) => self.within(key, value, 0.0, most, unit),
            None => Ok(default),
        };
        let stiffness = number(
            "stiffness_n_per_m",
            &section.stiffness_n_per_m,
            300.0,
            1e5,
            "N/m",
        )?;
        let world = match section.model.get_ref().as_str() {
            "tissue" => {
                let Some(scene) = &section.scene else {
                    let help = "add `scene = \"slab.toml\"`, relative to this file";
                    let span = section.model.span();
                    return Err(self.0.flaw(
                        span,
                        "missing key `scene`",
                        "needed by `tissue`",
                        Some(help),
                    ));
                };
                let path = self.0.resolve(scene.get_ref());
                if !path.is_file() {
                    let message = format!("there is no scene file {}", path.display());
                    let help = "paths are relative to the scenario file";
                    return Err(self
                        .0
                        .flaw(scene.span(), message, "no such file", Some(help)));
                }
                World::Tissue(path)
            }
            _ => {
                let radius = number("radius_m", &section.radius_m, 0.02, 1.0, "m")?;
                let push = number("force_n", &section.force_n, 1.0, 100.0, "N")?;
                let known = [
                    ("nobody", 0),
                    ("push", 1),
                    ("wall", 2),
                    ("ball", 3),
                    ("tissue", 4),
                ];
                match self.word("host model", &section.model, &known)? {
                    0 => World::Nobody,
                    1 => World::Push(push),
                    2 => World::Wall(stiffness),
                    _ => World::Ball(stiffness, radius),
                }
            }
        };
        let process = section.process.as_ref();
        if let Some(process) = process.filter(|process| *process.get_ref() && !world.is_tissue()) {
            let help = "`sutura run` solves scenes: `model = \"tissue\"`";
            let message = "a host in a process of its own needs a scene";
            return Err(self
                .0
                .flaw(process.span(), message, "not with this model", Some(help)));
        }
        let period = 1e3 / hz;
        let delay = match &section.delay_ms {
            Some(delay) => self.time("delay_ms", delay, 0.0)?,
            // A solve takes a period, as in every session in lockstep.
            None => period.round() as Ticks,
        };
        let horizon_us = match &section.horizon_ms {
            Some(horizon) => {
                Some((1e3 * self.within("horizon_ms", horizon, 0.0, 4e6, "ms")?) as u32)
            }
            None => None,
        };
        Ok(HostSpec {
            world,
            hz,
            delay,
            horizon_us,
            arms: section.arms.unwrap_or(true),
            process: process.is_some_and(|process| *process.get_ref()),
        })
    }

    fn order(&self, section: &OrderSection, end: Ticks) -> Result<(Ticks, Command), SceneError> {
        let known = [
            ("arm", Command::Arm),
            ("disarm", Command::Disarm),
            ("clear_fault", Command::ClearFault),
        ];
        let at = self.before("at_ms", &section.at_ms, end)?;
        Ok((at, self.word("order", &section.say, &known)?))
    }

    /// A time within the scenario.
    pub(super) fn before(
        &self,
        key: &str,
        value: &Number,
        end: Ticks,
    ) -> Result<Ticks, SceneError> {
        Ok(self
            .within(key, value, 0.0, end as f64, "ms, the scenario's end")?
            .round() as Ticks)
    }

    fn expect(&self, section: &ExpectSection) -> Result<Expect, SceneError> {
        let number = |key, value: &Option<Number>, unit| {
            let value = value.as_ref();
            value
                .map(|v| self.within(key, v, 0.0, 1e6, unit))
                .transpose()
        };
        let range = |key: &str, value: &Option<Spanned<[u32; 2]>>| match value {
            Some(value) if value.get_ref()[0] > value.get_ref()[1] => {
                let message = format!("{key}: the least must not be above the most");
                let help = "write `[least, most]`";
                Err(self
                    .0
                    .flaw(value.span(), message, "turned round", Some(help)))
            }
            Some(value) => Ok(Some(*value.get_ref())),
            None => Ok(None),
        };
        let modes = [
            Mode::Boot,
            Mode::Idle,
            Mode::Armed,
            Mode::Decaying,
            Mode::Fault,
        ];
        let modes = modes.map(|mode| (mode_word(mode), mode));
        let mode = section.mode.as_ref();
        let mut bits = 0;
        let names = faults::NAMES.map(|(bit, name)| (name, bit));
        for name in section.faults.iter().flat_map(|list| list.get_ref()) {
            bits |= self.word("fault of the console", name, &names)?;
        }
        Ok(Expect {
            force_n: number("force_n", &section.force_n, "N")?,
            felt_n: number("felt_n", &section.felt_n, "N")?,
            step_n: number("step_n", &section.step_n, "N")?,
            given_back_j: number("given_back_j", &section.given_back_j, "J")?,
            mode: mode
                .map(|word| self.word("mode", word, &modes))
                .transpose()?,
            faults: bits,
            rejected: range("rejected", &section.rejected)?,
            lost: range("lost", &section.lost)?,
            sessions: range("sessions", &section.sessions)?,
            refusals: range("refusals", &section.refusals)?,
        })
    }
}
