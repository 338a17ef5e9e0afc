//! One line of the tables: what is run, and what came of it.
//!
//! Entry point: [`Spec::measure`].

use super::around::{Around, Blocking};
use super::draws::Draw;
use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::measure::{Errors, Peaks, Punctures, Recovery, errors, peaks, punctures, recovery};
use super::notice::{Noticed, given_back_j, noticed};
use super::plant::{Mechanics, Off};
use super::run::{Host, Record, Setup, True, run, truth_along};
use super::scenes::Scene;
use super::scenes::needle::NeedleSlabs;
use super::scenes::palpation::Palpation;
use super::scenes::point::Point;
use super::scenes::rogue::Rogue;
use super::scenes::round::Round;
use super::scenes::slab::{Law, Slab};
use super::scenes::thread::WoundSlabs;
use super::scenes::turned::Turned;
use super::stiffest::{Search, stiffest};
use super::trials::{Factor, stalled_pct};
use crate::scene::SceneError;
use crate::session::{LINE_BYTES_PER_S, most_rows};
use serde::Serialize;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use sutura_shared::control::{Guards, Rendering, Tuning};
use sutura_shared::device::DeviceError;

/// Which scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Place {
    /// [`Point`].
    Point,
    /// [`Point::GRISTLE`].
    Gristle,
    /// [`Palpation`].
    Palpation,
    /// [`NeedleSlabs`].
    Needle,
    /// [`WoundSlabs`].
    Thread,
    /// [`Rogue`].
    Rogue(Rogue),
    /// [`Round::THIN`].
    RoundThin,
    /// [`Round::THICK`].
    RoundThick,
    /// [`Slab`].
    Slab(Law),
}

/// What is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Question {
    /// How far the force is off.
    Errors,
    /// How stiff tissue may be.
    Stiffest,
    /// How far the force is off, and what is noticed of it, where something is not as planned.
    Trial(Factor),
    /// How stiff it may be on a console that is not as described, and with a host that is not late.
    Corner,
    /// What happens when the link dies for 0.3 s, in a hold.
    Gap,
    /// What a host that sends nonsense can make the console do.
    Peaks,
}

/// One line, before it is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spec {
    /// What is asked.
    pub question: Question,
    /// What is touched.
    pub place: Place,
    /// Where the hand goes.
    pub motion: Motion,
    /// How it holds.
    pub grasp: Grasp,
    /// What is rendered; none for a scene that is solved in every tick.
    pub rendering: Option<Rendering>,
    /// The link.
    pub link: LinkSpec,
    /// How wrong the tangent is.
    pub tangent_scale: f64,
    /// Most rows of a frame; what the line carries if it does not say.
    pub most_rows: Option<usize>,
    /// Which guards are on.
    pub guards: Guards,
    /// The console.
    pub mechanics: Mechanics,
    /// What is around it.
    pub around: Around,
    /// \[s\].
    pub seconds: f64,
}

/// One line of the tables. Numbers that were not asked for are left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Case {
    /// All words below, for people and `--only`.
    pub case: String,
    /// `errors`, `trial`, `stability`, `corner`, `gap` or `rogue`.
    pub question: &'static str,
    /// Which scene.
    pub scene: String,
    /// What the hand does.
    pub hand: &'static str,
    /// `rigid`, `pen`, `free`, `hand-50` (N/m), `weight-10-g`.
    pub grasp: String,
    /// `full` for the scene solved in every tick.
    pub rendering: &'static str,
    /// \[1/s\].
    pub host_hz: f64,
    /// From the state to the arrival of its frame, without jitter \[ms\].
    pub delay_ms: f64,
    /// \[ms\].
    pub jitter_ms: f64,
    /// Part of the frames that is lost.
    pub loss: f64,
    /// Length of the bursts in which all is lost \[ms\].
    pub burst_ms: f64,
    /// Part of the frames that come after their successors.
    pub reordered: f64,
    /// How wrong the tangent is.
    pub tangent_scale: f64,
    /// Most rows in a frame.
    pub most_rows: usize,
    /// Damping of the console \[N s/m\].
    pub device_damping_n_s_per_m: f64,
    /// Most power of the console \[W\].
    pub device_max_power_w: f64,
    /// How it differs from its description: `nominal`, `+1-tick`, `lag-1-ms`, `mass-x2`, `torque-x0.8`.
    pub device: String,
    /// Guards that are off.
    pub guards_off: Vec<&'static str>,
    /// Errors, if asked for.
    #[serde(flatten)]
    pub errors: Option<Errors>,
    /// Largest stable stiffness \[N/m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_max_n_per_m: Option<f64>,
    /// That over the one of the full 1 kHz loop.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k_ratio: Option<f64>,
    /// Least mean force in a stable hold, over the true one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force_ratio: Option<f64>,
    /// The corner, if asked for.
    #[serde(flatten)]
    pub corner: Option<Corner>,
    /// The gap, if asked for.
    #[serde(flatten)]
    pub recovery: Option<Recovery>,
    /// When punctures were felt, where there were any.
    #[serde(flatten)]
    pub punctures: Option<Punctures>,
    /// Extremes, if asked for.
    #[serde(flatten)]
    pub peaks: Option<Peaks>,
    /// Most that the motors gave back in 100 ms beyond the true tissue \[mJ\], with errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub given_back_mj: Option<f64>,
    /// What a hand would notice, if it was a trial.
    #[serde(flatten)]
    pub noticed: Option<Noticed>,
    /// The trial, if it was one.
    #[serde(flatten)]
    pub trial: Option<Trial>,
    /// Least energy that the motors had taken, less what they had given \[J\]: the integral of F v of the true
    /// motion.
    pub energy_min_j: f64,
}

/// What makes a trial.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Trial {
    /// What is not as planned.
    pub factor: &'static str,
    /// Part of the time in which the host stalls, %.
    pub stalled_pct: f64,
    /// All that was drawn, of a draw.
    #[serde(flatten)]
    pub draw: Option<Draw>,
}

/// What a corner of the device has beside its largest stable stiffness.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Corner {
    /// Largest stable stiffness of the same console, hand and device with a host that solves every millisecond, without
    /// delay \[N/m\].
    pub k_reference_n_per_m: f64,
    /// The case's own over that.
    pub k_of_reference: f64,
    /// Most that the motors gave back in 100 ms beyond the true tissue, in any stable hold \[mJ\].
    pub given_back_mj: f64,
    /// The same of the reference \[mJ\].
    pub reference_given_back_mj: f64,
    /// What makes stiffer tissue unstable: `swing`, `growth`, `force` below half, `fault`.
    pub ends_by: &'static str,
}

/// Scenes and true forces that cases share.
pub struct Scenes {
    palpation: Palpation,
    needle: NeedleSlabs,
    thread: WoundSlabs,
    corotational: Slab,
    hyperelastic: Slab,
    known: Mutex<HashMap<(Place, Motion, u32), Known>>,
}

/// Solved by whoever needs it first.
type Known = Arc<OnceLock<Vec<True>>>;

impl Scenes {
    /// Builds them.
    ///
    /// # Errors
    /// None unless a shipped scene is not sound.
    pub fn load() -> Result<Self, SceneError> {
        Ok(Scenes {
            palpation: Palpation::load()?,
            needle: NeedleSlabs::load()?,
            thread: WoundSlabs::load()?,
            corotational: Slab::load(Law::Corotational)?,
            hyperelastic: Slab::load(Law::Hyperelastic)?,
            known: Mutex::default(),
        })
    }

    fn at<'a>(&'a self, place: &'a Place) -> &'a dyn Scene {
        match place {
            Place::Point => &Point::TISSUE,
            Place::Gristle => &Point::GRISTLE,
            Place::Palpation => &self.palpation,
            Place::Needle => &self.needle,
            Place::Thread => &self.thread,
            Place::Rogue(rogue) => rogue,
            Place::RoundThin => &Round::THIN,
            Place::RoundThick => &Round::THICK,
            Place::Slab(Law::Corotational) => &self.corotational,
            Place::Slab(Law::Hyperelastic) => &self.hyperelastic,
        }
    }

    fn known(&self, spec: &Spec) -> Known {
        let key = (spec.place, spec.motion, (spec.seconds * 1e3) as u32);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = Arc::clone(known.entry(key).or_default());
        // Others may look up theirs meanwhile.
        drop(known);
        slot.get_or_init(|| truth_along(self.at(&spec.place), spec.motion, spec.seconds));
        slot
    }
}

/// Names of guards, and whether each is on.
pub fn guards_by_name(guards: &Guards) -> [(&'static str, bool); 15] {
    [
        ("blend", guards.blend),
        ("trust", guards.trust),
        ("lead", guards.lead),
        ("bend", guards.bend),
        ("swing", guards.swing),
        ("tank", guards.tank),
        ("along", guards.along),
        ("credit", guards.credit),
        ("damping", guards.damping),
        ("horizon", guards.horizon),
        ("force", guards.force),
        ("slew", guards.slew),
        ("power", guards.power),
        ("overspeed", guards.overspeed),
        ("residual", guards.residual),
    ]
}

/// All guards but one; all for a name that is none.
pub fn all_but(name: &str) -> Guards {
    let mut guards = Guards::ALL;
    guards.switch_off(name);
    guards
}

impl Spec {
    /// Errors of a rigid hand on the point of tissue at the end of an ideal link, with all guards.
    pub fn errors(place: Place, motion: Motion, rendering: Rendering, host_hz: f64) -> Self {
        Spec {
            question: Question::Errors,
            place,
            motion,
            grasp: Grasp::Rigid,
            rendering: Some(rendering),
            link: LinkSpec::ideal(host_hz),
            tangent_scale: 1.0,
            most_rows: None,
            guards: Guards::ALL,
            mechanics: Mechanics::LIGHT,
            around: Around::planned(),
            seconds: 4.0,
        }
    }

    /// The largest stable stiffness of the point of tissue.
    pub fn stiffest(rendering: Rendering, host_hz: f64, tangent_scale: f64) -> Self {
        Spec {
            question: Question::Stiffest,
            grasp: Grasp::PEN,
            tangent_scale,
            seconds: 3.0,
            ..Spec::errors(Place::Point, Motion::Hold, rendering, host_hz)
        }
    }

    /// A hold through a dead link.
    pub fn gap(host_hz: f64) -> Self {
        Spec {
            question: Question::Gap,
            link: LinkSpec {
                burst_every_s: GAP_END_S,
                burst_s: GAP_S,
                ..LinkSpec::ideal(host_hz)
            },
            ..Spec::stiffest(Rendering::Rows, host_hz, 1.0)
        }
    }

    /// A host that sends nonsense: to a free grip that holds nothing, or to a hand that fills the tank.
    pub fn rogue(rogue: Rogue, motion: Motion) -> Self {
        Spec {
            question: Question::Peaks,
            grasp: match motion {
                Motion::Hold => Grasp::FREE,
                _ => Grasp::Rigid,
            },
            seconds: 1.0,
            ..Spec::errors(Place::Rogue(rogue), motion, Rendering::Rows, 100.0)
        }
    }

    /// The same without late host: solved in every tick.
    pub fn full(self) -> Self {
        Spec {
            rendering: None,
            link: LinkSpec {
                delay_s: 0.0,
                ..LinkSpec::ideal(1000.0)
            },
            ..self
        }
    }

    fn host(&self) -> Host {
        match self.rendering {
            Some(_) => Host::Late(self.link),
            None => Host::Full,
        }
    }

    fn tuning(&self) -> Tuning {
        Tuning {
            rendering: self.rendering.unwrap_or_default(),
            guards: self.guards,
        }
    }

    /// Speed limit of the grip \[m/s\].
    fn fastest(&self) -> f64 {
        f64::from(self.mechanics.description().max_grip_speed_m_per_s)
    }

    /// Rows that a frame may have.
    pub fn rows(&self) -> usize {
        let carried = || most_rows(LINE_BYTES_PER_S, self.link.host_hz, 1000.0);
        match self.rendering {
            Some(Rendering::Rows) => self.most_rows.unwrap_or_else(carried),
            _ => 0,
        }
    }

    /// The line without its figures.
    pub fn case(&self) -> Case {
        let link = &self.link;
        let mut case = Case {
            case: String::new(),
            question: match self.question {
                Question::Errors => "errors",
                Question::Stiffest => "stability",
                Question::Corner => "corner",
                Question::Trial(_) => "trial",
                Question::Gap => "gap",
                Question::Peaks => "rogue",
            },
            scene: match self.place {
                Place::Point => "point".to_owned(),
                Place::Gristle => "gristle".to_owned(),
                Place::Palpation => "palpation".to_owned(),
                Place::Needle => "needle".to_owned(),
                Place::Thread => "thread".to_owned(),
                Place::Rogue(rogue) => rogue.scene_name().to_owned(),
                Place::RoundThin => Round::THIN.name().to_owned(),
                Place::RoundThick => Round::THICK.name().to_owned(),
                Place::Slab(law) => law.word().to_owned(),
            },
            hand: self.motion.name(),
            grasp: self.grasp.word(),
            device: self.mechanics.off.word(),
            rendering: match self.rendering {
                None => "full",
                Some(Rendering::Hold) => "hold",
                Some(Rendering::LinearTime) => "linear-time",
                Some(Rendering::Tangent) => "tangent",
                Some(Rendering::Rows) => "rows",
            },
            host_hz: link.host_hz,
            delay_ms: link.delay_s * 1e3,
            jitter_ms: link.jitter_s * 1e3,
            loss: link.loss,
            burst_ms: link.burst_s * 1e3,
            reordered: link.reordered,
            tangent_scale: self.tangent_scale,
            most_rows: self.rows(),
            device_damping_n_s_per_m: self.mechanics.damping_n_s_per_m,
            device_max_power_w: self.mechanics.max_power_w,
            guards_off: guards_by_name(&self.guards)
                .into_iter()
                .filter_map(|(name, on)| (!on).then_some(name))
                .collect(),
            ..Case::default()
        };
        case.case = case.words(self);
        case
    }

    /// Runs it.
    ///
    /// # Errors
    /// Mechanics that make no valid device.
    pub fn measure(&self, scenes: &Scenes) -> Result<Case, DeviceError> {
        let mut case = self.case();
        if matches!(self.question, Question::Stiffest | Question::Corner) {
            let search = Search {
                tuning: self.tuning(),
                host: self.host(),
                tangent_scale: self.tangent_scale,
                mechanics: self.mechanics,
                grasp: self.grasp,
                tissue: Point::TISSUE,
            };
            let found = stiffest(&search)?;
            if self.question == Question::Corner {
                let own = stiffest(&Search {
                    host: Host::Late(LinkSpec::IMMEDIATE),
                    ..search
                })?;
                case.corner = Some(Corner {
                    k_reference_n_per_m: own.k_max_n_per_m,
                    k_of_reference: found.k_max_n_per_m / own.k_max_n_per_m,
                    given_back_mj: 1e3 * found.most_given_back_j,
                    reference_given_back_mj: 1e3 * own.most_given_back_j,
                    ends_by: found.ends_by.word(),
                });
            }
            case.k_max_n_per_m = Some(found.k_max_n_per_m);
            case.force_ratio = found
                .least_force_ratio
                .is_finite()
                .then_some(found.least_force_ratio);
            case.energy_min_j = found.least_energy_j;
            return Ok(case);
        }
        let (record, stalled_pct) = self.run(scenes)?;
        case.energy_min_j = record.least_energy_j;
        if matches!(self.question, Question::Errors | Question::Trial(_)) {
            case.errors = Some(errors(&record));
            case.punctures = punctures(&record);
            case.given_back_mj = Some(1e3 * given_back_j(&record));
        }
        match self.question {
            Question::Trial(factor) => {
                case.noticed = Some(noticed(&record));
                case.trial = Some(Trial {
                    factor: factor.word(),
                    stalled_pct,
                    draw: match factor {
                        Factor::Draw(draw) => Some(draw),
                        _ => None,
                    },
                });
            }
            Question::Gap => case.recovery = Some(recovery(&record, GAP_END_S - GAP_S, GAP_END_S)),
            Question::Peaks => case.peaks = Some(peaks(&record, self.fastest())),
            Question::Errors | Question::Stiffest | Question::Corner => {}
        }
        Ok(case)
    }

    /// The run itself, tick by tick.
    ///
    /// # Errors
    /// As [`Spec::measure`].
    pub fn record(&self, scenes: &Scenes) -> Result<Record, DeviceError> {
        self.run(scenes).map(|(record, _)| record)
    }

    /// The run, and the part of it in which the host stalls, %.
    fn run(&self, scenes: &Scenes) -> Result<(Record, f64), DeviceError> {
        let turn = self.around.turn;
        let is_rigid = self.grasp == Grasp::Rigid;
        // Where a hand gives way, it touches about as often.
        let known = (is_rigid || self.around.blocks.is_some()).then(|| {
            let known = scenes.known(self);
            let straight = known.get().map(Vec::as_slice).unwrap_or_default();
            let turned = |now: &True| True {
                force_n: turn.turned(now.force_n),
                ..*now
            };
            straight.iter().map(turned).collect::<Vec<_>>()
        });
        let blocking = self.around.blocks.zip(known.as_ref());
        let hz = self.link.host_hz;
        let blocking = blocking.map(|(seed, known)| Blocking::new(seed, known, hz));
        let stalled_pct = stalled_pct(blocking.as_ref(), self.seconds);
        let straight = scenes.at(&self.place);
        let turned = Turned {
            scene: straight,
            turn,
        };
        let record = run(&Setup {
            scene: if turn.is_none() { straight } else { &turned },
            motion: self.motion,
            grasp: self.grasp,
            mechanics: self.mechanics,
            tuning: self.tuning(),
            host: self.host(),
            tangent_scale: self.tangent_scale,
            most_rows: self.rows(),
            seconds: self.seconds,
            knock: None,
            truth: known.as_deref().filter(|_| is_rigid),
            phase: self.around.phase,
            cold: self.around.cold,
            blocking: blocking.as_ref(),
        })?;
        Ok((record, stalled_pct))
    }
}

/// When the link comes back \[s\], and for how long it was dead: longer than any horizon and its decay.
const GAP_END_S: f64 = 1.8;
const GAP_S: f64 = 0.3;

impl Case {
    /// Whether some frames did not come when they should.
    pub fn is_lossy(&self) -> bool {
        self.loss > 0.0 || self.burst_ms > 0.0 || self.reordered > 0.0
    }

    /// Whether neither tank nor damping watches over energy.
    pub fn is_unguarded(&self) -> bool {
        ["tank", "damping"]
            .iter()
            .all(|name| self.guards_off.contains(name))
    }

    fn words(&self, spec: &Spec) -> String {
        let mut words = vec![
            self.question.to_owned(),
            self.scene.clone(),
            self.hand.to_owned(),
            self.grasp.clone(),
            self.rendering.to_owned(),
        ];
        if self.rendering != "full" {
            words.push(format!("{:.0}-hz", self.host_hz));
            if self.tangent_scale != 1.0 {
                words.push(format!("x{}", self.tangent_scale));
            }
            if spec.most_rows.is_some() {
                words.push(format!("{}-rows", self.most_rows));
            }
        }
        if self.loss > 0.0 {
            words.push(format!("loss-{}", self.loss));
        }
        if self.burst_ms > 0.0 && self.question != "gap" {
            words.push(format!("burst-{:.0}-ms", self.burst_ms));
        }
        if self.reordered > 0.0 {
            words.push("reordered".to_owned());
        }
        if self.device_damping_n_s_per_m != Mechanics::LIGHT.damping_n_s_per_m {
            words.push(format!("b-{}", self.device_damping_n_s_per_m));
        }
        if self.device_max_power_w != Mechanics::LIGHT.max_power_w {
            words.push(format!("{}-w", self.device_max_power_w));
        }
        if let Question::Trial(factor) = spec.question {
            words.push(factor.name(&spec.around));
            if matches!(factor, Factor::Draw(_)) {
                return words.join(" ");
            }
            if factor == Factor::Cold {
                words.push(format!("phase-{:.2}", spec.around.phase));
            }
        }
        if spec.question == Question::Corner || spec.mechanics.off != Off::NONE {
            words.push(self.device.clone());
        }
        for name in &self.guards_off {
            words.push(format!("no-{name}"));
        }
        words.join(" ")
    }
}
