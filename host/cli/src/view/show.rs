//! The thread that shows a session on its page: pictures, rows of plots, figures.
//!
//! Entry points: [`Show::begin`], [`Show::end`]. It is nice, and makes no more pictures than a fifth of a core is good for.

use super::hello::{Kind, hello};
use super::live::Tap;
use super::page::Page;
use super::telemetry::Telemetry;
use crate::failure::{Cause, Failure};
use serde_json::{Map, Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_host::core_time::core_time;
use sutura_host::picture::{Heard, Offer, Painter, Scalar, SolvesOf};
use sutura_host::scene::Scene;
use sutura_host::session::{LimitedTicks, LinkSummary, Plan, SceneSolver, Snapshot, ViewSummary};
use sutura_host::thread::Hanging;
use sutura_host::times::Times;
use sutura_shared::wire::message::Report;
use sutura_view::{Beginning, Shared};

/// Between two looks for a new snapshot.
const LOOK_EVERY: Duration = Duration::from_millis(4);
/// Between two looks where nobody watches.
const REST: Duration = Duration::from_millis(100);
/// Between two blocks of telemetry.
const BLOCK_EVERY: Duration = Duration::from_millis(50);
/// Between two sets of figures.
const GAUGES_EVERY: Duration = Duration::from_millis(500);
/// Part of a core that pictures may take.
const SHARE: f64 = 0.2;
/// Pictures a second at most.
const MOST_HZ: f64 = 60.0;
/// Lower than all that a session needs.
const NICE: i32 = 10;
/// Longest time of a picture that its percentiles tell apart \[us\].
const LONGEST_US: u64 = 10_000_000;

/// What the session itself says of how it goes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Going {
    /// The console's newest report.
    pub report: Option<Report>,
    /// The link so far; none in lockstep.
    pub link: Option<LinkSummary>,
    /// Ticks in which a limit of the device took a part of the force away.
    pub limited: Option<LimitedTicks>,
    /// Whether time stands still.
    pub paused: bool,
    /// Session time per wall time that is wanted; none in real time.
    pub wanted_speed: Option<f64>,
    /// Whether all of it is written to a file; none where pages have no say in it.
    pub recording: Option<bool>,
}

/// A session that is shown.
pub struct Show {
    shared: Arc<Shared>,
    telemetry: Arc<Telemetry>,
    offer: Arc<Offer>,
    going: Arc<Mutex<Going>>,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Figures>,
}

#[derive(Debug)]
struct Figures {
    wanted: u64,
    made: u64,
    took_us: Times,
}

impl Show {
    /// Tells the page of a session that begins, and shows it from now on.
    ///
    /// # Errors
    /// No thread.
    pub fn begin(
        page: &Page,
        scene: &Scene,
        plan: &Plan,
        solver: &SceneSolver,
        kind: &Kind<'_>,
        live: Option<Tap>,
    ) -> Result<Show, Failure> {
        let shared = page.shared().clone();
        let painter = Painter::new(scene, shared.session() + 1);
        let mut geometry = Vec::new();
        painter.boundary().encode(0, &mut geometry);
        shared.begin(Beginning {
            hello: hello(scene, plan, kind),
            geometry: Some(geometry),
            recorded: false,
        });
        let telemetry = Telemetry::new(SolvesOf {
            session: shared.session(),
            needles: scene.needles.len(),
            threads: scene.threads.len(),
        })
        .with(live);
        let offer = Offer::new(solver);
        let stop = Arc::new(AtomicBool::new(false));
        let going = Arc::new(Mutex::new(Going::default()));
        let showing = Showing {
            own: Box::new(Snapshot::of(solver)),
            hanging: solver.model().and_then(|model| Hanging::new(model)),
            heard: offer.heard(),
            has_model: kind.has_model,
            painter,
            shared: shared.clone(),
            telemetry: telemetry.clone(),
            offer: offer.clone(),
            going: going.clone(),
            stop: stop.clone(),
            figures: Figures {
                wanted: 0,
                made: 0,
                took_us: Times::new(LONGEST_US),
            },
            cost_s: 0.0,
            hz: 0.0,
        };
        let thread = std::thread::Builder::new()
            .name("sutura-picture".to_owned())
            .spawn(move || showing.run());
        let thread = thread.map_err(|error| {
            let message = format!("there is no thread that makes pictures: {error}");
            Failure::say(
                Cause::Failed,
                message,
                "end other programs, or leave out --view",
            )
        })?;
        Ok(Show {
            shared,
            telemetry,
            offer,
            going,
            stop,
            thread,
        })
    }

    /// Where the solver's states go.
    pub fn offer(&self) -> Arc<Offer> {
        self.offer.clone()
    }

    /// What the recorder tells of.
    pub fn telemetry(&self) -> &Arc<Telemetry> {
        &self.telemetry
    }

    /// How the session goes, for its figures.
    pub fn going(&self, change: impl FnOnce(&mut Going)) {
        change(&mut self.going.lock().unwrap_or_else(PoisonError::into_inner));
    }

    /// The session goes on otherwise: what pages were told of it before.
    pub fn changed(&self, said: &[(&str, Value)]) {
        for (key, value) in said {
            self.shared.amend(key, value.clone());
        }
        self.shared.say_again();
    }

    /// The session is over; what there is to say of how it was shown.
    pub fn end(self, place: Option<String>) -> Option<ViewSummary> {
        self.stop.store(true, Ordering::Relaxed);
        self.telemetry.event("ended", "the session is over", "");
        let figures = self.thread.join();
        self.offer.want(0);
        self.telemetry.show(&self.shared);
        let offer_us = self.offer.took_us();
        let all = self.shared.figures();
        let (wanted, made, took_us) = figures.map_or((0, 0, [0.0; 2]), |figures| {
            let took = [0.5, 0.99].map(|part| figures.took_us.quantile(part) as f64);
            (figures.wanted, figures.made, took)
        });
        Some(ViewSummary::new(
            place?,
            all.joined,
            [wanted, made, all.sent],
            took_us,
            offer_us,
        ))
    }
}

/// The thread's own.
struct Showing {
    painter: Painter,
    own: Box<Snapshot>,
    /// Threads that hang, and their beats.
    hanging: Option<Hanging>,
    heard: Option<Heard>,
    has_model: bool,
    shared: Arc<Shared>,
    telemetry: Arc<Telemetry>,
    offer: Arc<Offer>,
    going: Arc<Mutex<Going>>,
    stop: Arc<AtomicBool>,
    figures: Figures,
    /// Of a picture, the newest ones more than those before \[s\].
    cost_s: f64,
    /// Pictures a second at present.
    hz: f64,
}

impl Showing {
    fn run(mut self) -> Figures {
        be_nice();
        let (mut block, mut gauges) = (Instant::now(), Instant::now());
        let mut sequence = 0;
        let mut painted = Instant::now();
        let mut wanted_since = Instant::now();
        while !self.stop.load(Ordering::Relaxed) {
            let wants = self.shared.wait_for_watcher(REST);
            self.pace(wants.picture_hz);
            if wants.picture_hz > 0.0 {
                let passed_s = wanted_since.elapsed().as_secs_f64();
                if passed_s * wants.picture_hz >= 1.0 {
                    self.figures.wanted += (passed_s * wants.picture_hz) as u64;
                    wanted_since = Instant::now();
                }
                let scalar = wants.scalar.as_deref().and_then(Scalar::named);
                let scalar = scalar.filter(|scalar| self.has_model || !scalar.needs_model());
                let is_due = painted.elapsed().as_secs_f64() * self.hz >= 1.0;
                if (is_due || !self.going().paused) && self.offer.take(&mut self.own) {
                    painted = Instant::now();
                    sequence += 1;
                    self.paint(scalar, sequence);
                }
                std::thread::sleep(LOOK_EVERY);
            } else {
                wanted_since = Instant::now();
            }
            if block.elapsed() >= BLOCK_EVERY {
                block = Instant::now();
                self.telemetry.show(&self.shared);
            }
            if gauges.elapsed() >= GAUGES_EVERY {
                gauges = Instant::now();
                self.gauges(wants.picture_hz);
            }
        }
        self.figures
    }

    /// As many pictures as are wanted, and as a fifth of a core is good for.
    fn pace(&mut self, wanted_hz: f64) {
        let affordable_hz = SHARE / self.cost_s.max(1e-6);
        self.hz = wanted_hz.min(MOST_HZ).min(affordable_hz);
        let going = self.going();
        let period_us = match going.wanted_speed {
            // What has been stepped to is seen, whatever came just before.
            _ if going.paused => 0.0,
            speed => 1e6 * speed.unwrap_or(1.0) / self.hz,
        };
        if let Some(heard) = self.heard.as_mut().filter(|_| self.hz > 0.0) {
            heard.open(&self.own);
        }
        // Less than one tick is every solve.
        self.offer.want(if self.hz > 0.0 {
            (period_us as u64).max(1)
        } else {
            0
        });
    }

    fn going(&self) -> Going {
        *self.going.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn paint(&mut self, scalar: Option<Scalar>, sequence: u32) {
        let began = core_time();
        self.hear();
        let mut bytes = Vec::new();
        self.painter
            .paint(&self.own, self.hanging.as_mut(), scalar, sequence)
            .encode(&mut bytes);
        let took = core_time().saturating_sub(began);
        self.figures.made += 1;
        self.figures.took_us.record(took.as_micros() as u64);
        self.cost_s = 0.9 * self.cost_s + 0.1 * took.as_secs_f64();
        self.shared.picture(bytes);
    }

    /// Moves threads that hang on to the last beat before the newest snapshot.
    fn hear(&mut self) {
        let (Some(heard), Some(hanging)) = (&mut self.heard, &mut self.hanging) else {
            return;
        };
        heard.up_to(&self.own, |beat, begins| {
            if begins {
                hanging.begin();
            }
            beat.beat(hanging, &beat.positions_m());
        });
    }

    fn gauges(&self, wanted_hz: f64) {
        let going = self.going();
        let mut said =
            self.telemetry
                .gauges(going.report.as_ref(), going.link.as_ref(), going.limited);
        let all = self.shared.figures();
        let own = json!({
            "paused": going.paused,
            "wanted_speed": going.wanted_speed,
            "recording": going.recording,
            "pictures": {"wanted": self.figures.wanted, "made": self.figures.made, "sent": all.sent},
            "picture_hz": self.hz.min(wanted_hz),
            "picture_us": 1e6 * self.cost_s,
            "clients": all.clients,
            "controller": all.controller,
            "connected": true,
        });
        said.extend(own.as_object().cloned().unwrap_or_default());
        amend(&self.shared, &said);
        self.shared.text(&Value::Object(said));
    }
}

/// What newcomers hear of mode and faults.
fn amend(shared: &Shared, said: &Map<String, Value>) {
    for key in ["mode", "faults"] {
        if let Some(value) = said.get(key) {
            shared.amend(key, value.clone());
        }
    }
}

/// The thread gives way to whatever the session needs.
fn be_nice() {
    // On Linux every thread has a niceness of its own; elsewhere it is the process's, which must not give way.
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::nice(NICE) {
        tracing::debug!("pictures are made at the usual priority: {error}");
    }
}
