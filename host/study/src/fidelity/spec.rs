//! What is run: one line of the tables before it has figures.
//!
//! Entry points: [`Spec::errors`] and its neighbours, [`Spec::measure`].

use super::around::{Around, Blocking};
use super::case::{Case, Corner, Trial};
use super::hand::{Grasp, Motion};
use super::link::LinkSpec;
use super::measure::{errors, peaks, punctures, slips};
use super::notice::{given_back_j, noticed};
use super::places::{Place, RUBBED_THICK, RUBBED_THIN, Scenes};
use super::plant::Mechanics;
use super::returns::{Away, Returned};
use super::run::{Host, Record, Setup, True, run};
use super::scenes::Scene;
use super::scenes::point::Point;
use super::scenes::rogue::Rogue;
use super::scenes::round::Round;
use super::scenes::turned::Turned;
use super::stiffest::{Search, stiffest};
use super::stops::{STOPS_AT_S, Stop, force_after_n};
use super::switches::{Mendings, Switch, guards_by_name};
use super::trials::{Factor, stalled_pct};
use sutura_host::session::{LINE_BYTES_PER_S, most_rows};
use sutura_shared::control::{Guards, Rendering, Tuning};
use sutura_shared::device::DeviceError;

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
    /// How a force comes back in a hold.
    Return(Away),
    /// What is left of a force once the console is stopped.
    Stop(Stop),
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
    /// What the host does about its being late.
    pub mendings: Mendings,
    /// The console.
    pub mechanics: Mechanics,
    /// What is around it.
    pub around: Around,
    /// \[s\].
    pub seconds: f64,
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
            mendings: Mendings::ALL,
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

    /// The same with one thing switched off.
    pub fn without(self, switch: Switch) -> Self {
        let (guards, mendings) = switch.off();
        Spec {
            guards,
            mendings,
            ..self
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
                Question::Return(_) => "return",
                Question::Stop(_) => "stop",
                Question::Peaks => "rogue",
            },
            scene: match self.place {
                Place::Point => "point".to_owned(),
                Place::Gristle => "gristle".to_owned(),
                Place::Palpation => "palpation".to_owned(),
                Place::Rubbing => "rubbing".to_owned(),
                Place::Needle => "needle".to_owned(),
                Place::Thread => "thread".to_owned(),
                Place::Rogue(rogue) => rogue.scene_name().to_owned(),
                Place::RoundThin => Round::THIN.name().to_owned(),
                Place::RoundThick => Round::THICK.name().to_owned(),
                Place::RubbingThin => RUBBED_THIN.name().to_owned(),
                Place::RubbingThick => RUBBED_THICK.name().to_owned(),
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
                .chain(self.mendings.by_name())
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
        let (record, blocking) = self.run(scenes)?;
        case.energy_min_j = record.least_energy_j;
        if matches!(self.question, Question::Errors | Question::Trial(_)) {
            case.errors = Some(errors(&record));
            case.punctures = punctures(&record);
            let drags = (Place::Rubbing, Motion::Strokes) == (self.place, self.motion);
            case.slips = drags.then(|| slips(&record)).flatten();
            case.given_back_mj = Some(1e3 * given_back_j(&record));
        }
        match self.question {
            Question::Trial(factor) => {
                case.noticed = Some(noticed(&record));
                case.trial = Some(Trial {
                    factor: factor.word(),
                    stalled_pct: stalled_pct(blocking.as_ref(), self.seconds),
                    longest_stall_ms: blocking.map_or(0.0, |blocking| 1e3 * blocking.longest_s()),
                    draw: match factor {
                        Factor::Draw(draw) => Some(draw),
                        _ => None,
                    },
                });
            }
            Question::Return(away) => {
                let rest_m = match self.grasp {
                    Grasp::Rigid => f64::INFINITY,
                    _ => scenes.rest_m(self)?,
                };
                case.returned = Some(Returned::of(&record, away, rest_m));
            }
            Question::Stop(_) => case.force_after_stop_n = Some(force_after_n(&record)),
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

    /// The run, and when its host stalls.
    fn run(&self, scenes: &Scenes) -> Result<(Record, Option<Blocking>), DeviceError> {
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
        let straight = scenes.at(&self.place);
        let turned = Turned {
            scene: straight,
            turn,
        };
        let scene: &dyn Scene = if turn.is_none() { straight } else { &turned };
        let record = run(&Setup {
            truth: known.as_deref().filter(|_| is_rigid),
            blocking: blocking.as_ref(),
            ..self.setup(scene)
        })?;
        Ok((record, blocking))
    }

    /// Where its hand goes, whatever the true force is there.
    ///
    /// # Errors
    /// As [`Spec::measure`].
    pub(super) fn path(&self, scenes: &Scenes) -> Result<Record, DeviceError> {
        run(&Setup {
            truth: Some(&[]),
            ..self.setup(scenes.at(&self.place))
        })
    }

    /// Of a truth that is not known, and a host that does not block.
    fn setup<'a>(&self, scene: &'a dyn Scene) -> Setup<'a> {
        Setup {
            scene,
            motion: self.motion,
            grasp: self.grasp,
            mechanics: self.mechanics,
            tuning: self.tuning(),
            host: self.host(),
            tangent_scale: self.tangent_scale,
            most_rows: self.rows(),
            seconds: self.seconds,
            knock: None,
            truth: None,
            phase: self.around.phase,
            cold: self.around.cold,
            blocking: None,
            arms_s: match self.question {
                Question::Return(away) => away.arms_s(),
                _ => 0.0,
            },
            stop: match self.question {
                Question::Stop(stop) => Some((STOPS_AT_S, stop)),
                _ => None,
            },
            mendings: self.mendings,
        }
    }
}
