//! The page of `sutura run`: while the session runs, and with its recording afterwards.
//!
//! Entry points: [`Viewed::open`], [`Viewed::begin`], [`Viewed::end`].

use super::PageArgs;
use super::attendant::{COMMANDS, JAWS, PageAttendant, SIMULATED, TAKE_OUT};
use super::guide::Guide;
use super::hello::Kind;
use super::live::Live;
use super::page::Page;
use super::recorded;
use super::saves::Saves;
use super::show::Show;
use super::take_out::TakeOut;
use crate::attendant::Operator;
use crate::failure::{Cause, Failure};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use sutura_host::picture::Offer;
use sutura_host::recording::{Saver, Seen};
use sutura_host::scene::Scene;
use sutura_host::session::{Attendant, Plan, Progress, SceneSolver, ViewSummary};
use tempfile::NamedTempFile;

/// A session that has a page.
pub struct Viewed {
    page: Page,
    show: Option<Show>,
    /// What is recorded for the time line afterwards, where there is a page.
    kept: Option<NamedTempFile>,
    /// Channels for other programs.
    live: Option<Live>,
    /// The console's tool, if that has jaws that the page may close.
    jaws: Option<u8>,
    /// Ways out of the tissue for a simulated console's tool.
    out: Option<TakeOut>,
}

impl Viewed {
    /// Opens the page, before the session begins.
    ///
    /// # Errors
    /// No port, or no room for the recording that it shows afterwards.
    pub fn open(args: &PageArgs) -> Result<Viewed, Failure> {
        let kept = tempfile::Builder::new()
            .prefix("sutura-")
            .suffix(".mcap")
            .tempfile();
        let kept = kept.map_err(|error| {
            let message = format!("there is no place for the session's recording: {error}");
            Failure::say(
                Cause::Failed,
                message,
                "set TMPDIR to a folder that is yours, or leave out --view",
            )
        })?;
        Viewed::of(Page::open(args)?, Some(kept), args)
    }

    /// Shows the session to this program's terminal and its channels alone: there is no page, and nothing afterwards.
    ///
    /// # Errors
    /// No port for the channels.
    pub fn inside(args: &PageArgs) -> Result<Viewed, Failure> {
        Viewed::of(Page::inside(), None, args)
    }

    fn of(page: Page, kept: Option<NamedTempFile>, args: &PageArgs) -> Result<Viewed, Failure> {
        Ok(Viewed {
            live: Live::open(args, page.shared())?,
            page,
            show: None,
            kept,
            jaws: None,
            out: None,
        })
    }

    /// What is shown, for a part of this program.
    #[cfg(feature = "top")]
    pub fn shared(&self) -> &Arc<sutura_view::Shared> {
        self.page.shared()
    }

    /// The session begins: in lockstep it is only watched.
    ///
    /// # Errors
    /// No thread.
    pub fn begin(
        &mut self,
        scene: &Scene,
        plan: &Plan,
        solver: &SceneSolver,
        console: &str,
        lockstep: bool,
    ) -> Result<(), Failure> {
        let simulated = matches!(console, "virtual" | "qemu" | "qemu-uart");
        let mut commands = vec!["scalar"];
        if !lockstep {
            commands = COMMANDS.to_vec();
            if simulated {
                commands.extend(SIMULATED);
                self.out = TakeOut::of(scene, solver, plan);
                commands.extend(self.out.as_ref().map(|_| TAKE_OUT));
            }
            self.jaws = scene.driven_jaws();
            commands.extend(self.jaws.map(|_| JAWS));
        }
        let kind = Kind {
            source: "live",
            pace: if lockstep { "lockstep" } else { "real-time" },
            console,
            motors: !simulated,
            commands,
            has_model: solver.model().is_some(),
            ..Kind::default()
        };
        let live = self.live.as_ref().map(Live::tap);
        self.show = Some(Show::begin(&self.page, scene, plan, solver, &kind, live)?);
        Ok(())
    }

    /// Where the solver's states go.
    pub fn offer(&self) -> Option<Arc<Offer>> {
        self.show.as_ref().map(Show::offer)
    }

    /// What the recorder tells of.
    pub fn seen(&self) -> Option<Seen> {
        self.show.as_ref().map(|show| show.telemetry().seen())
    }

    /// Where the session is recorded if nobody said where.
    pub fn kept(&self) -> Option<&Path> {
        self.kept.as_ref().map(|kept| kept.path())
    }

    /// An attendant whom the page can ask, too.
    pub fn attendant(
        &mut self,
        operator: Operator,
        plan: &Plan,
        simulated: bool,
        (saver, last): (Saver, PathBuf),
    ) -> Box<dyn Attendant> {
        match (self.page.take_asked(), &self.show) {
            (Some(asked), Some(show)) => {
                let telemetry = show.telemetry().clone();
                let guide = Guide::new(plan.hand, plan.device.kinematics);
                let hand = (simulated.then_some(guide), self.out.take());
                let saves = Saves::new(saver, telemetry.clone(), last, None);
                Box::new(PageAttendant::new(
                    operator,
                    asked,
                    hand,
                    (saves, telemetry),
                    self.jaws,
                ))
            }
            _ => Box::new(operator),
        }
    }

    /// How far the session is.
    pub fn progress(&self, note: &Progress<'_>) {
        if let Some(show) = &self.show {
            show.going(|going| {
                (going.report, going.link) = (note.report.copied(), note.link);
                going.limited = Some(note.limited);
            });
        }
    }

    /// The session is over.
    pub fn end(&mut self) -> Option<ViewSummary> {
        let place = self.page.place();
        self.show.take().and_then(|show| show.end(place))
    }

    /// Whether somebody has looked.
    pub fn was_seen(&self) -> bool {
        self.page.shared().figures().joined > 0
    }

    /// Stays with the recording of the session until `stop` is set, while anybody looks.
    ///
    /// # Errors
    /// A recording that cannot be shown.
    pub fn stay(&self, file: &Path, stop: &Arc<AtomicBool>) -> Result<(), Failure> {
        let Some(url) = self.page.url() else {
            return Ok(());
        };
        note!("the page stays with the session's recording, at {url}; Ctrl-C ends it");
        let shown = recorded::show(&self.page, recorded::Opened::read(file)?, None, stop);
        match shown {
            // The session has its result, and this is how its page is left.
            Err(failure) if failure.cause == Cause::Interrupted => Ok(()),
            shown => shown,
        }
    }
}

/// Whether somebody sits at a desktop who could look at a page.
pub fn has_desktop() -> bool {
    use std::io::IsTerminal as _;
    let set = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    (set("DISPLAY") || set("WAYLAND_DISPLAY")) && std::io::stderr().is_terminal()
}
