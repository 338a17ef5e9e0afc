//! What a scene's session says of its steps in the end: the hardest press, needles and threads at their worst.
//!
//! Entry points: [`Peaks::step`], [`Peaks::press`], [`Peaks::said`].

use crate::jaws::{JawsReport, Pads};
use crate::needle::NeedleReport;
use crate::output::tip_word;
use crate::scene::{Needle, Scene};
use crate::step::StepReport;
use serde_json::{Map, Value, json};

/// The worst so far.
#[derive(Clone, Debug)]
pub(super) struct Peaks {
    deepest: Deepest,
    needles: Vec<NeedleTally>,
    jaws: Vec<JawsTally>,
    /// Largest tension at an end of each thread \[N\].
    pub tension_n: Vec<f64>,
    /// The newest step that found a balance.
    pub last_good: StepReport,
}

/// What the hardest press looked like.
#[derive(Clone, Copy, Debug, Default)]
struct Deepest {
    force_n: f64,
    position_m: [f64; 3],
    rows: u32,
    stored_energy_j: f64,
}

/// Jaws as the last step left them, and what they pulled with at most \[N\].
#[derive(Clone, Copy, Debug, Default)]
struct JawsTally {
    last: JawsReport,
    peak_n: f64,
}

/// A needle as the last step left it, and at its worst.
#[derive(Clone, Copy, Debug, Default)]
struct NeedleTally {
    last: NeedleReport,
    peak_axial_n: f64,
    most_crossings: u32,
}

impl Peaks {
    /// Nothing yet.
    pub fn new(scene: &Scene) -> Self {
        Self {
            deepest: Deepest::default(),
            needles: scene.needles.iter().map(NeedleTally::of).collect(),
            jaws: vec![JawsTally::default(); scene.jaws.len()],
            tension_n: vec![0.0; scene.threads.len()],
            last_good: StepReport::default(),
        }
    }

    /// Takes note of a step.
    pub fn step(&mut self, report: &StepReport) {
        for (tally, report) in self.needles.iter_mut().zip(report.needles()) {
            tally.last = *report;
            tally.peak_axial_n = tally.peak_axial_n.max(report.axial_n.abs());
            tally.most_crossings = tally.most_crossings.max(report.crossings);
        }
        for (tally, report) in self.jaws.iter_mut().zip(report.jaws()) {
            tally.last = *report;
            tally.peak_n = tally.peak_n.max(norm(&report.force_n));
        }
        for (peak, thread) in self.tension_n.iter_mut().zip(report.threads()) {
            *peak = peak.max(report.most_tension_n(thread.id));
        }
        if report.status.has_balance() {
            self.last_good = *report;
        }
    }

    /// Takes note of what the driven tool felt in a step that had its grip there \[m\], (3). Returns the force's magnitude \[N\].
    pub fn press(&mut self, report: &StepReport, position_m: [f64; 3]) -> f64 {
        let Some(contact) = report.contacts().first() else {
            return 0.0;
        };
        let [x, y, z, ..] = contact.wrench;
        let force_n = (x * x + y * y + z * z).sqrt();
        if force_n > self.deepest.force_n {
            self.deepest = Deepest {
                force_n,
                position_m,
                rows: contact.rows,
                stored_energy_j: report.stored_energy_j,
            };
        }
        force_n
    }

    /// Boundaries that needles have broken through.
    pub fn punctures(&self) -> u32 {
        let punctures = self.needles.iter().map(|needle| needle.last.punctures);
        punctures.sum()
    }

    /// Its part of the summary; the first of the contacts is the console's if it drives a tool.
    pub fn said(&self, is_driven: bool) -> Map<String, Value> {
        let Deepest {
            force_n,
            position_m,
            rows,
            stored_energy_j,
        } = self.deepest;
        let contacts = self.last_good.contacts().iter();
        let held = contacts.skip(usize::from(is_driven)).map(|contact| {
            let [x, y, z, ..] = contact.wrench;
            json!({ "tool": contact.id, "force_n": [-x, -y, -z], "rows": contact.rows })
        });
        let mut said = Map::new();
        said.insert("held".to_owned(), held.collect());
        let peak = json!({
            "force_n": force_n,
            "position_m": position_m,
            "rows": rows,
            "stored_energy_j": stored_energy_j,
        });
        said.insert("peak".to_owned(), peak);
        if !self.needles.is_empty() {
            said.insert("punctures".to_owned(), self.punctures().into());
            let needles = self.needles.iter().map(|needle| needle.to_json());
            said.insert("needles".to_owned(), needles.collect());
        }
        if !self.jaws.is_empty() {
            let jaws = self.jaws.iter().map(|jaws| jaws.to_json());
            said.insert("jaws".to_owned(), jaws.collect());
        }
        said
    }
}

fn norm([x, y, z]: &[f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

impl JawsTally {
    fn to_json(self) -> Value {
        let last = self.last;
        let limit_n = last.limit_n.is_finite().then_some(last.limit_n);
        json!({
            "tool": last.tool,
            "closed": last.pads != Pads::Open,
            "points": last.points,
            "slipping": last.slipping,
            "force_n": last.force_n,
            "peak_n": self.peak_n,
            "in_plane_n": last.in_plane_n,
            "limit_n": limit_n,
            "friction_j": last.friction_j,
        })
    }
}

impl NeedleTally {
    fn of(needle: &Needle) -> Self {
        NeedleTally {
            last: NeedleReport {
                id: needle.id,
                ..NeedleReport::default()
            },
            ..NeedleTally::default()
        }
    }

    fn to_json(self) -> Value {
        let [friction, cutting, release] = self.last.dissipated_j;
        json!({
            "needle": self.last.id,
            "held_by": self.last.held_by,
            "tip": tip_word(self.last.tip),
            "punctures": self.last.punctures,
            "crossings": self.last.crossings,
            "most_crossings": self.most_crossings,
            "axial_n": self.last.axial_n,
            "peak_axial_n": self.peak_axial_n,
            "dissipated_j": { "friction": friction, "cutting": cutting, "release": release },
            "guessed": self.last.guessed,
        })
    }
}
