//! `sutura run`: the main job. A scene, a console, a session, a summary.

use crate::attendant::{Lasting, Operator, WAITS, WITHHELD};
use crate::choice;
use crate::display::{self, Display};
use crate::failure::{Cause, Failure};
use crate::recording::{self, Recording};
use crate::replay;
use crate::series::{self, SERIES_HZ};
use crate::signals::{Stoppable, stop_on_signals, stopped};
use crate::top::Top;
use crate::view::PageArgs;
use crate::view::session::{Viewed, has_desktop};
use crate::{Format, Global, files};
use clap::{Args, ValueEnum};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
#[cfg(unix)]
use sutura_hil::QemuError;
use sutura_hil::{NativeConsole, VirtualConsole};
use sutura_host::link::{
    LinkError, LinkOptions, LockstepConsole, Port, VIRTUAL_HELP, drain, is_virtual, knock,
    open_serial,
};
use sutura_host::picture::Showing;
use sutura_host::recording::{Tap, TappedConsole, TappedPort, TappedSolver};
use sutura_host::scene::{LONGEST_S, Scene, Tissue, host_hz};
use sutura_host::session::{
    self, Attendant, EndingKind, Line, Plan, PlanError, Progress, SceneSolver, Scheduling,
    SessionError, Solve, Summary, UNSENDABLE, check_rate, needs_restart, run_lockstep,
    run_real_time,
};
use sutura_host::wound::Overlap;
use sutura_shared::control::TICK_HZ;
use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::inputs;
use sutura_shared::wire::message::{Fixture, State};

/// Runs a scene on a console: tissue is solved here, its force is felt there.
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct RunArgs {
    /// Scene file; scenes/palpation.toml (or its copy inside this program) when left out.
    pub scene: Option<PathBuf>,
    /// `virtual` (in this process), `qemu` (the firmware image, in lockstep),
    /// `qemu-uart` (the firmware image over its emulated serial port), or a serial port.
    #[arg(long, value_name = "CONSOLE", default_value = "virtual")]
    pub console: String,
    /// Length of the session by the console's clock [s]; the scene's when left out.
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Tissue model, in place of the scene's: `linear`, `corotational` with the scene's `[tissue.corotational]`, `hyperelastic`, or
    /// one that tools stick to, such as `shape-matching`, also with a setting: `"shape-matching: 4 rings"`; `auto` measures and
    /// chooses.
    #[arg(long, value_name = "NAME", value_parser = Tissue::named)]
    pub tissue: Option<Tissue>,
    /// Solver steps a second, 14 to 1000 [Hz]; the scene's when left out.
    #[arg(long, value_name = "HZ", value_parser = host_rate)]
    pub host_hz: Option<f64>,
    /// What the console is given to render from, on lines fast enough for it; when left out, rows of linear, corotational and
    /// hyperelastic tissue, else the tangent.
    #[arg(long, value_name = "R")]
    pub rendering: Option<Rendering>,
    /// What a solver step may take [ms]: without --tissue the most accurate model that does so here is taken, of those with the
    /// scene's contact law, by measurement before the session. Ends with code 7 if one step in a hundred took longer.
    #[arg(long, value_name = "B", value_parser = positive)]
    pub budget_ms: Option<f64>,
    /// Steps host and virtual console tick by tick instead of in real time: two runs give one trace.
    #[arg(long)]
    pub lockstep: bool,
    /// One JSON object a line on stdout while the session runs.
    #[arg(long)]
    pub stream: bool,
    /// What the console renders by itself, beside the scene: `wall:z=M,k=N_PER_M[,b=N_S_PER_M]` or
    /// `coupling:x=M,y=M,z=M,k=N_PER_M[,b=N_S_PER_M]`.
    #[arg(long, value_name = "FIXTURE", value_parser = crate::fixture::parse)]
    pub fixture: Option<Fixture>,
    /// Arms the console again by itself when it was lost and came back, and when it has let go, since no contact came in
    /// time for half a second: that three times a minute at most. Otherwise Enter does, or a line on standard input.
    #[arg(long)]
    pub rearm: bool,
    /// Clears a fault that is latched in the console from before.
    #[arg(long)]
    pub clear_fault: bool,
    /// Writes the whole session to this file, for `sutura replay` and for other programs: MCAP, 10 to 30 MB a minute.
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Writes the session to this new folder for ParaView once it has ended: its recording, and a row of .vtu files from running that
    /// again.
    #[arg(long, value_name = "DIR")]
    pub series: Option<PathBuf>,
    /// Files of `--series` a second of the session; at most one for each solve.
    #[arg(long, value_name = "HZ", value_parser = positive, default_value_t = SERIES_HZ)]
    pub series_hz: f64,
    /// Where the last 30 s go, to be looked at, when the console ends in a fault or is lost; and on SIGUSR1, which without
    /// this writes sutura-last.mcap here.
    #[arg(long, value_name = "FILE")]
    pub save_last: Option<PathBuf>,
    /// Firmware image for `qemu` and `qemu-uart`, in place of the one built from this checkout.
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Shows the session on a live page, whose address is printed. At a desktop a session with the virtual console has one unless
    /// it is in lockstep.
    #[arg(long)]
    pub view: bool,
    /// Shows the session's figures on the terminal in place of the bar, with keys for safe stop and arming: see `sutura top`. Without
    /// a terminal one line a second on stderr.
    #[arg(long, conflicts_with = "stream")]
    pub top: bool,
    #[command(flatten)]
    pub page: PageArgs,
}

const EXAMPLES: &str = "\
Examples:
  sutura run                                              5 s palpation with a virtual console
  sutura run scenes/palpation.toml --console qemu --format json
  sutura run --console /dev/ttyACM0 --host-hz 500 --budget-ms 2
  sutura run --lockstep                                   the same bits at every run
  sutura run --tissue corotational --host-hz 30           large displacements, at the pace that they take
  sutura run --console /dev/ttyACM0 --seconds 3600 --rearm  goes on by itself after a loose contact
  sutura run --host-hz 50 --budget-ms 15                  the most accurate model that is fast enough here
  sutura run --tissue auto                                the same, with the host's period as the budget
  sutura run --tissue hyperelastic --host-hz 20 --lockstep  the reference, in time that is not the clock's
  sutura run --rendering hold --host-hz 30                how it feels without local models
  sutura run --record session.mcap                        then: sutura replay session.mcap
  sutura run --console /dev/ttyACM0 --view                a live page: forces, plots, safe stop
  sutura run --console /dev/ttyACM0 --top                 the figures in the terminal, safe stop by a key
  sutura run --view --foxglove                            live channels for Foxglove, Lichtblick and PlotJuggler, too
  sutura run --series pictures                            then: paraview pictures/session.pvd
  sutura run --console /dev/ttyACM0 --save-last fault.mcap

A step that is too slow, a lost console or a wrong solve never leaves a force standing: the console lets
it go to zero by itself.";

/// What the console's force between two solver steps is taken from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Rendering {
    /// The last step's force.
    Hold,
    /// The last step's force and its tangent.
    Tangent,
    /// The contact problem itself, solved by the console at every tick.
    Rows,
}

impl From<Rendering> for session::Rendering {
    fn from(rendering: Rendering) -> Self {
        match rendering {
            Rendering::Hold => session::Rendering::Hold,
            Rendering::Tangent => session::Rendering::Tangent,
            Rendering::Rows => session::Rendering::Rows,
        }
    }
}

/// A number above 0.
///
/// # Errors
/// What else it is.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("must be a number above 0".to_owned()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    match positive(text) {
        Ok(value) if value > LONGEST_S => Err(format!("must be at most {LONGEST_S}, a day")),
        other => other,
    }
}

/// Solver steps a second \[Hz\].
///
/// # Errors
/// What else it is.
pub fn host_rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= f64::from(TICK_HZ) => Ok(value),
        _ => Err(format!(
            "must be above 0 and at most {TICK_HZ}: the console asks for nothing faster than its own tick"
        )),
    }
}

/// The firmware image over its emulated serial port.
const UART: &str = "qemu-uart";
/// Most frames a second over the emulated UART, which takes 8 to 12 kB/s.
const UART_HZ: f64 = 30.0;
/// Ticks between two states over the emulated UART: every byte is an interrupt of the emulated chip.
const UART_STATE_EVERY: u16 = 10;
/// What it takes for sure \[bytes/s\].
const UART_BYTES_PER_S: f64 = 8e3;
/// Wall-clock time that an emulated session may take besides its console time \[s\]: the session runs faster
/// than that, but the emulator must end some time.
#[cfg(unix)]
const EMULATOR_SPARE: Duration = Duration::from_secs(120);

/// Runs the session and prints its summary.
///
/// # Errors
/// Everything that keeps the session from running to its end, a latched fault, a missed budget.
pub fn run(args: &RunArgs, global: &Global) -> Result<(), Failure> {
    let asked = recording::asked();
    may_write(args, global)?;
    // Before a port is opened: some boards start anew with that.
    let document = crate::scene::document(args.scene.as_deref())?;
    if let Some(host_hz) = args.host_hz.or_else(|| host_hz(&document)) {
        check_rate(host_hz, TICK_HZ).map_err(|error| session_failure(error, &args.console))?;
    }
    // Before a mesh is made, measured or factored: a console that cannot be had is said at once.
    let mut door = Door::open(args)?;
    let shown = crate::work::watch();
    let (mut scene, sources) = crate::scene::open_with_sources(&document)?;
    for file in [&recording::file(args), &args.save_last]
        .into_iter()
        .flatten()
    {
        files::never_over(file, &document.paths())?;
    }
    if let Some(folder) = &args.series {
        files::never_into(folder, series::is_file, &document.paths())?;
    }
    // The scene's own settings stay for what `auto` takes.
    if let Some(tissue) = args.tissue.filter(|tissue| *tissue != Tissue::Auto) {
        scene.tissue = tissue.instead_of(scene.tissue);
    }
    drop(shown);
    let mut plan = plan(args, &scene)?;
    let board_rows_hz = scene.device.and_then(|device| device.board_rows_hz);
    let chosen = choice::settle(args, &mut scene, &plan)?;
    if args.rendering.is_none() {
        plan.rendering = scene.usual_rendering();
    }
    if args.console == UART {
        note!(
            "the emulated UART takes 8 to 12 kB/s: at most {UART_HZ} frames a second of at most 220 bytes"
        );
    }
    let mut solver = {
        let _shown = crate::work::watch();
        SceneSolver::for_session(&scene, &plan)?
    };
    let lockstep = args.lockstep || args.console == "qemu";
    // In lockstep columns are computed in step: when they are there must not depend on this machine's pace.
    if !lockstep {
        solver.start_worker();
    }
    let mut viewed = viewed(args, global, lockstep)?;
    if let Some(viewed) = &mut viewed {
        viewed.begin(&scene, &plan, &solver, &args.console, lockstep)?;
    }
    let kept = viewed.as_ref().and_then(Viewed::kept);
    let seen = viewed.as_ref().and_then(Viewed::seen);
    let recording = Recording::start(args, &plan, &scene, sources, lockstep, asked, (kept, seen))?;
    let tapped = TappedSolver::new(&mut solver, recording.tap()).sketched(&scene);
    let offer = viewed.as_ref().and_then(Viewed::offer);
    let mut solver = Showing::new(tapped, offer);
    let stop = stop_on_signals()?;
    let operator: Box<dyn Attendant> = match &mut viewed {
        Some(viewed) => {
            let simulated = args.console == "virtual" || args.console == UART;
            let operator = Operator::new(args.rearm);
            let operator = if args.top {
                operator.at_screen()
            } else {
                operator
            };
            viewed.attendant(operator, &plan, simulated, recording.saver())
        }
        None => Box::new(Operator::new(args.rearm)),
    };
    let mut display = Display::new(
        args.stream,
        global.format,
        args.top,
        plan.seconds,
        !lockstep,
    );
    let top = match &viewed {
        Some(viewed) if args.top => Some(Top::start(viewed, stop.clone())?),
        _ => None,
    };
    let (mut withholding, mut waiting) = (Lasting::default(), Lasting::default());
    let mut progress = |note: &Progress<'_>| {
        let heard = display.show(note).is_ok();
        let withheld = |state: &State| state.inputs & inputs::WITHHELD != 0;
        let is_withheld = note.state.is_some_and(withheld);
        if withholding.lasts(note.elapsed_s, is_withheld) {
            note!("{WITHHELD}");
        }
        if waiting.lasts(note.elapsed_s, note.needle_waits) {
            note!("{WAITS}");
        }
        recording.save_if_asked();
        if let Some(viewed) = &viewed {
            viewed.progress(note);
        }
        if !heard || stop.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    let tap = recording.tap();
    let way = Way {
        door: &mut door,
        tap: &tap,
        operator,
    };
    let summary = {
        // In lockstep the solver is on this thread: a signal is heard in the midst of a step.
        let _ends = lockstep.then(|| Stoppable::by(&stop));
        session(args, way, &plan, &mut solver, &mut progress)
    };
    if let Some(top) = top {
        top.end();
    }
    display.finish();
    let file = recording.file();
    let view = viewed.as_mut().and_then(Viewed::end);
    let (summary, [recorded, saved]) = recording.finish(summary)?;
    let summary = Summary {
        chosen,
        view,
        board_rows_hz,
        ..summary
    };
    // A signal that has ended the session is not one that ends this.
    let stop_drawing = match stop.load(Ordering::Relaxed) {
        true => Arc::default(),
        false => stop.clone(),
    };
    let drawn = || match (&args.series, recording::file(args)) {
        (Some(folder), Some(file)) => replay::draw(&file, (folder, args.series_hz), &stop_drawing),
        _ => Ok(()),
    };
    // Before the summary, whose status says all that went wrong.
    let verdict = recorded.and_then(|()| drawn());
    let verdict = verdict.map_err(Failure::after_summary);
    let verdict = verdict.and_then(|()| self::verdict(args, &summary));
    let verdict = verdict.and_then(|()| saved.map_err(Failure::after_summary));
    for refused in &summary.refusals {
        note!("{refused}; {REFUSED_HELP}");
    }
    let summary = said_of(summary, &verdict);
    match global.format {
        Format::Json => display::object(&summary),
        Format::Text => display::lines(display::table(&summary).trim_end()),
    }
    match (&viewed, file) {
        (Some(viewed), Some(file)) if viewed.was_seen() && !stop.load(Ordering::Relaxed) => {
            viewed.stay(&file, &stop).map_err(Failure::after_summary)?;
        }
        (Some(_), _) if !args.view && !is_inside(args) => note!("see it: sutura view"),
        _ => {}
    }
    verdict
}

/// Whether all files may be written that are asked for; makes the folder for those that are many.
fn may_write(args: &RunArgs, global: &Global) -> Result<(), Failure> {
    if let Some(folder) = &args.series {
        files::folder("--series", folder, global)?;
    }
    let recording = recording::file(args);
    let is_named = args.record.is_some();
    let option = if is_named { "--record" } else { "--series" };
    let outputs = [
        (option, recording.as_deref()),
        ("--save-last", args.save_last.as_deref()),
    ];
    files::apart(&outputs)?;
    for file in [&recording, &args.save_last].into_iter().flatten() {
        files::free(file, global)?;
    }
    match &args.series {
        Some(folder) => files::apart_from_those_in(("--series", folder), series::is_file, &outputs),
        None => Ok(()),
    }
}

/// Whether it is shown to this program's terminal or channels, without a page.
fn is_inside(args: &RunArgs) -> bool {
    !args.view && (args.top || args.page.foxglove)
}

/// The page of a session, if it is to have one: asked for, or because somebody at a desktop may look.
fn viewed(args: &RunArgs, global: &Global, lockstep: bool) -> Result<Option<Viewed>, Failure> {
    if args.view {
        return Viewed::open(&args.page).map(Some);
    }
    if is_inside(args) {
        return Viewed::inside(&args.page).map(Some);
    }
    let is_plain = args.console == "virtual" && !lockstep && !args.stream;
    if !(is_plain && global.format == Format::Text && has_desktop()) {
        return Ok(None);
    }
    // Nobody has asked for it: without a port there is just none.
    Ok(Viewed::open(&args.page).ok())
}

fn plan(args: &RunArgs, scene: &Scene) -> Result<Plan, Failure> {
    let plan = Plan::of_scene(scene)?;
    let plan = Plan {
        host_hz: args.host_hz.unwrap_or(plan.host_hz),
        seconds: args.seconds.unwrap_or(plan.seconds),
        clear_fault: args.clear_fault,
        fixture: args.fixture.unwrap_or_default(),
        rendering: args.rendering.map_or(plan.rendering, Into::into),
        ..plan
    };
    if args.console != UART {
        return Ok(plan);
    }
    Ok(Plan {
        host_hz: plan.host_hz.min(UART_HZ),
        state_every: UART_STATE_EVERY,
        line_bytes_per_s: UART_BYTES_PER_S,
        ..plan
    })
}

/// The way to the console, found before the session's solver is built.
struct Door {
    /// A port is opened only once: some boards start anew with that.
    port: Option<Box<dyn Port>>,
    /// Of an emulated console.
    #[cfg_attr(not(unix), allow(dead_code, reason = "there is no emulator"))]
    image: Option<PathBuf>,
}

impl Door {
    /// Opens a port and asks whether a console is behind it; has an emulator's image built.
    ///
    /// # Errors
    /// There is no console, or it cannot be run as asked.
    fn open(args: &RunArgs) -> Result<Door, Failure> {
        let name = args.console.as_str();
        let mut door = Door {
            port: None,
            image: None,
        };
        match name {
            "virtual" => {}
            #[cfg(unix)]
            "qemu" | UART => {
                emulated::check().map_err(emulated::failure)?;
                let image = emulated::image(args.image.as_deref())?;
                if !image.is_file() {
                    return Err(emulated::failure(QemuError::NoImage { path: image }));
                }
                door.image = Some(image);
            }
            _ if args.lockstep => {
                let message = format!("`{name}` runs by its own clock");
                let help = "--lockstep goes with `--console virtual`; `--console qemu` is always in lockstep";
                return Err(Failure::say(Cause::BadInput, message, help));
            }
            _ => {
                let mut port = open_serial(name).map_err(link_failure)?;
                // A session that nobody uses is nobody's: the next one is opened as if this had not been.
                knock(port.as_mut(), &options()).map_err(link_failure)?;
                door.port = Some(port);
            }
        }
        Ok(door)
    }
}

type Watcher<'a> = dyn FnMut(&Progress<'_>) -> ControlFlow<()> + 'a;

/// What leads to the console, and who looks after it.
struct Way<'a> {
    door: &'a mut Door,
    tap: &'a Tap,
    operator: Box<dyn Attendant>,
}

fn session(
    args: &RunArgs,
    way: Way<'_>,
    plan: &Plan,
    solver: &mut dyn Solve,
    progress: &mut Watcher,
) -> Result<Summary, Failure> {
    let Way {
        door,
        tap,
        operator,
    } = way;
    let named = |summary: Summary| Summary {
        console: args.console.clone(),
        ..summary
    };
    let summary = match args.console.as_str() {
        "virtual" if args.lockstep => {
            let mut console = lockstep_console(&plan.device)?;
            let mut console = TappedConsole::new(&mut console, tap.clone());
            in_lockstep(&mut console, plan, solver, progress)
        }
        "virtual" => {
            let mut console =
                VirtualConsole::start_in_memory(&plan.device).map_err(link_failure)?;
            let line = Line::Once {
                port: tapped(console.host_port().map_err(link_failure)?, tap),
                attendant: Some(operator),
                limits: Some(console.limits()),
            };
            let options = options();
            let summary = in_real_time(line, "virtual", options, plan, solver, progress)?;
            let got = console.granted().word();
            let scheduling = summary.scheduling.map(|rest| Scheduling {
                console: Some(got),
                ..rest
            });
            Ok(Summary {
                scheduling,
                ..summary
            })
        }
        #[cfg(unix)]
        "qemu" => {
            let image = door.image.take().unwrap_or_default();
            let limit = EMULATOR_SPARE + Duration::from_secs_f64(plan.seconds);
            let mut console =
                sutura_hil::QemuConsole::start(image, limit).map_err(emulated::failure)?;
            let mut tapped = TappedConsole::new(&mut console, tap.clone());
            let summary = in_lockstep(&mut tapped, plan, solver, progress)?;
            console.quit().map_err(emulated::failure)?;
            Ok(summary)
        }
        #[cfg(unix)]
        UART => {
            let image = door.image.take().unwrap_or_default();
            let limit = EMULATOR_SPARE + Duration::from_secs_f64(plan.seconds);
            let qemu = sutura_hil::qemu::with_uart(image, limit).map_err(emulated::failure)?;
            let port = open_serial(qemu.uart().unwrap_or_default()).map_err(link_failure)?;
            let contact_spacing = Duration::from_secs_f64(1.0 / UART_HZ);
            let options = LinkOptions {
                contact_spacing,
                ..options()
            };
            let line = tapped(port, tap).into();
            let summary = in_real_time(line, UART, options, plan, solver, progress)?;
            qemu.check_log(|_| false).map_err(emulated::failure)?;
            Ok(summary)
        }
        port => in_real_time(
            line(port, door.port.take(), operator, tap),
            port,
            options(),
            plan,
            solver,
            progress,
        ),
    };
    summary.map(named)
}

/// The way to the console at `path`, again and again; `port` if it is open already.
fn line(
    path: &str,
    mut port: Option<Box<dyn Port>>,
    attendant: Box<dyn Attendant>,
    tap: &Tap,
) -> Line {
    let (path, tap) = (path.to_owned(), tap.clone());
    let mut open = move || match port.take() {
        Some(mut port) => drain(port.as_mut(), &options()).map(|()| port),
        None => open_serial(&path),
    };
    Line::Again {
        connect: Box::new(move || Ok(tapped(open()?, &tap))),
        attendant,
    }
}

fn tapped(port: Box<dyn Port>, tap: &Tap) -> Box<dyn Port> {
    Box::new(TappedPort::new(port, tap.clone()))
}

/// A link that is given up on Ctrl-C.
fn options() -> LinkOptions {
    LinkOptions {
        give_up: stopped,
        ..LinkOptions::default()
    }
}

fn in_real_time(
    line: Line,
    name: &str,
    options: LinkOptions,
    plan: &Plan,
    solver: &mut dyn Solve,
    progress: &mut Watcher,
) -> Result<Summary, Failure> {
    let options = LinkOptions {
        real_time: true,
        at_once: true,
        ..options
    };
    run_real_time(line, options, plan, solver, progress)
        .map_err(|error| session_failure(error, name))
}

/// A simulated console in this process that takes a tick per exchange.
///
/// # Errors
/// Bad input: no console computes with what describes it.
pub fn lockstep_console(device: &DeviceDescription) -> Result<NativeConsole, Failure> {
    NativeConsole::new(device).map_err(|error| {
        let message = format!("the device is unusable: {error}");
        Failure::say(Cause::BadInput, message, "correct its device file")
    })
}

fn in_lockstep(
    console: &mut dyn LockstepConsole,
    plan: &Plan,
    solver: &mut dyn Solve,
    progress: &mut Watcher,
) -> Result<Summary, Failure> {
    run_lockstep(console, plan, solver, progress).map_err(|error| session_failure(error, "virtual"))
}

impl From<PlanError> for Failure {
    fn from(error: PlanError) -> Failure {
        Failure::new(Cause::BadInput, error)
    }
}

/// A failed link with its exit code and the next step.
pub fn link_failure(error: LinkError) -> Failure {
    let cause = match &error {
        LinkError::Mismatch { .. } | LinkError::NoStates { refused: true, .. } => Cause::Protocol,
        LinkError::GivenUp { .. } => Cause::Interrupted,
        LinkError::Unsendable { .. } => Cause::BadInput,
        _ => Cause::NoConsole,
    };
    Failure::say(cause, error.to_string(), error.help())
}

/// Way out of a fault that no order clears.
const RESTART: &str = "check the encoders' cables, put the grip where the console's origin is, and restart the console: --clear-fault does not help";

/// A failed session with its exit code and the next step.
pub fn session_failure(error: SessionError, console: &str) -> Failure {
    let message = error.to_string();
    match error {
        SessionError::Link(error) => link_failure(error),
        SessionError::Fault { faults } => Failure::say(
            Cause::Fault,
            message,
            if needs_restart(&faults) {
                RESTART
            } else {
                "remove the cause (is the emergency stop pressed?), then run again with --clear-fault"
            },
        ),
        SessionError::OtherDevice { console, .. } => Failure::say(
            Cause::BadInput,
            message,
            format!(
                "write `device = \"{console}\"` into the scene, with that device's file in `devices/` beside it, or connect the other console"
            ),
        ),
        SessionError::NotArmed { .. } | SessionError::Silent { .. } => {
            let help = if is_virtual(console) {
                VIRTUAL_HELP
            } else {
                "press the console's reset and run again"
            };
            Failure::say(Cause::NoConsole, message, help)
        }
        SessionError::TooSlow { least_hz, .. } => Failure::say(
            Cause::BadInput,
            message,
            format!(
                "give `--host-hz {least_hz}` or more; a model that is slower than that can be looked at with `sutura solve`"
            ),
        ),
        SessionError::Solver => Failure::say(
            Cause::Failed,
            message,
            "this is a defect: please report it with the scene",
        ),
    }
}

/// The summary with a status that says of a failure what the session's own does not.
fn said_of(summary: Summary, verdict: &Result<(), Failure>) -> Summary {
    let is_good = ["ok", "limited"]
        .iter()
        .any(|word| summary.status.starts_with(word));
    match verdict {
        Err(failure) if is_good => Summary {
            status: failure.cause.word().to_owned(),
            ..summary
        },
        _ => summary,
    }
}

/// Whether a session that ran to its end is a success.
fn verdict(args: &RunArgs, summary: &Summary) -> Result<(), Failure> {
    let why = &summary.ending.why;
    match summary.ending.kind {
        EndingKind::Fault => {
            let message = format!("the console is in a latched fault: {why}");
            let help = if needs_restart(&summary.faults) {
                RESTART
            } else {
                "remove the cause, then run again with --clear-fault"
            };
            return Err(Failure::say(Cause::Fault, message, help).after_summary());
        }
        kind if kind.is_untrusted() => {
            let (message, help) = distrust(kind, summary);
            return Err(Failure::say(Cause::NotRendered, message, help).after_summary());
        }
        EndingKind::Idle => return Err(let_go(args, summary).after_summary()),
        EndingKind::Limited => note!("limited: {why}; {}", limited_help(summary)),
        EndingKind::Stopped => note!("stopped: {why}"),
        _ => {}
    }
    match summary.contact_steps {
        0 => note!("the tool in the hand touched nothing"),
        steps if summary.is_faint() => note!(
            "in {steps} steps something was held or touched, and the largest force was {:.4} mN",
            1e3 * summary.force_n.peak.max(summary.force_n.solved_peak)
        ),
        _ => {}
    }
    if let Some(budget_ms) = args.budget_ms
        && summary.step_us.p99 > 1e3 * budget_ms
    {
        let message = format!(
            "one step in a hundred took longer than {:.3} ms; the budget is {budget_ms} ms",
            1e-3 * summary.step_us.p99
        );
        let help = "use a coarser mesh, a lower --host-hz, another `--tissue`; `sutura scene explain` says what takes how long";
        return Err(Failure::say(Cause::Budget, message, help).after_summary());
    }
    Ok(())
}

/// Next step of a session whose force the device cut off.
fn limited_help(summary: &Summary) -> &'static str {
    let ticks = &summary.ticks_limited;
    match ticks.are_many() {
        true if 2 * ticks.current.unwrap_or(0) > ticks.force => {
            "`ticks_limited` counts the ticks by limit; press less deep, or take motors with more current"
        }
        true => {
            "`ticks_limited` counts the ticks by limit; press less deep, or take a device with more force"
        }
        false => {
            "`ticks_limited` and `ticks_withheld` count the ticks; begin outside the tissue, go slower, or take a device with more slew"
        }
    }
}

/// Next step of a session whose link refused many frames.
const REFUSED_HELP: &str = "`frames` counts them; check the cable and what else writes to the port, and that both ends are of one build";

/// Describes a session whose forces cannot be trusted, and says the next step.
fn distrust(kind: EndingKind, summary: &Summary) -> (String, &'static str) {
    let why = &summary.ending.why;
    match kind {
        EndingKind::Inside => (why.clone(), help_for_withheld(Some("inside"))),
        EndingKind::Overlap => (why.clone(), Overlap::HELP),
        EndingKind::Untouched => (
            why.clone(),
            "the console felt what steps had foretold, and no step found it: a higher --host-hz, or a tool that is not so thin",
        ),
        EndingKind::Behind => (why.clone(), help_for_withheld(Some("behind"))),
        EndingKind::Faint => (
            why.clone(),
            "no finger notices less than 5 mN: is the modulus in Pa? Soft tissue has 1e3 to 1e6",
        ),
        _ => (
            format!("what was touched was not felt: {why}"),
            match summary.mostly_withheld() {
                None if summary.is_cut() => limited_help(summary),
                why => help_for_withheld(why),
            },
        ),
    }
}

/// Why a console rests at the end that nobody stopped.
fn let_go(args: &RunArgs, summary: &Summary) -> Failure {
    if summary.link.sessions > 1 {
        let message = "the console was lost, came back, and was not armed again";
        let help = match is_virtual(&args.console) {
            true => VIRTUAL_HELP,
            false => {
                "check its cable and its power; --rearm arms a console that came back by itself"
            }
        };
        return Failure::say(Cause::Failed, message, help);
    }
    let message = "the console let go: no contact that it could use came for half a second";
    let help = match withheld_for_long(summary) {
        Some((why, steps)) => format!(
            "the last {steps} steps were withheld ({why}): {}",
            help_for_withheld(Some(why))
        ),
        None => {
            "the host was late for that long: see `session_us` and `machine_late_us`, `sutura doctor` says what this machine can do; --rearm arms the console again".to_owned()
        }
    };
    Failure::say(Cause::Failed, message, help)
}

/// Why the newest steps were withheld, where that alone made the console let go: half of the time that it waits.
fn withheld_for_long(summary: &Summary) -> Option<(&'static str, u64)> {
    let last = summary.withheld_last;
    last.filter(|(_, steps)| *steps as f64 >= 0.25 * summary.host_hz)
}

/// What to do about steps that were withheld for this reason; without one, contacts came too late.
fn help_for_withheld(why: Option<&str>) -> &'static str {
    match why {
        Some("inside") => {
            "a tool was inside the tissue: it began there, or the surface slipped around it; begin outside, press less deep, give the tool `friction`, \
             or take a finer mesh"
        }
        Some("not-converged") => {
            "the model did not find a balance: a finer mesh, another `--tissue`, or a hand that presses less deep"
        }
        Some("behind") => "the hand was faster than a step follows: a higher --host-hz",
        Some("too-many-rows") => {
            "the tools touched more vertices than a step has room for: a coarser mesh or a smaller tool; `sutura scene check` says where"
        }
        Some("waiting") => "compliance columns came too late: a coarser mesh, or a lower --host-hz",
        Some(UNSENDABLE) => {
            "what steps found is beyond what a frame takes, 1e4 N and 1e7 N/m: are the moduli in Pa, and the needle's friction in N/m? Then softer \
             tissue, or a hand that goes less deep"
        }
        Some(_) => "see `steps_withheld`",
        None => "contacts came too late to be used: a higher --host-hz, or a faster `--tissue`",
    }
}

#[cfg(unix)]
pub mod emulated {
    //! Where the image comes from, and what is wrong when it does not run.

    use crate::failure::{Cause, Failure};
    use std::path::{Path, PathBuf};
    use std::process::{Command, Stdio};
    use sutura_hil::{QemuError, qemu};

    /// What the image is called.
    const IMAGE: &str = "sutura-virtual";

    /// Whether there is an emulator to run.
    ///
    /// # Errors
    /// [`QemuError::NoQemu`].
    pub fn check() -> Result<(), QemuError> {
        let found = Command::new(qemu::PROGRAM)
            .arg("--version")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        match found {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Err(QemuError::NoQemu),
            _ => Ok(()),
        }
    }

    /// The image that the user named, one that was installed beside this program, or that of the checkout which this program was
    /// built in, built anew if anything has changed and cargo is there.
    pub fn image(named: Option<&Path>) -> Result<PathBuf, Failure> {
        if let Some(image) = named {
            return Ok(image.to_owned());
        }
        let installed = installed();
        if let Some(image) = installed.iter().find(|image| image.is_file()) {
            return Ok(image.clone());
        }
        let checkout = Path::new(env!("CARGO_MANIFEST_DIR"))
            .ancestors()
            .nth(2)
            .filter(|root| root.join("firmware").is_dir());
        if let Some(root) = checkout {
            build(root)?;
        }
        let image = qemu::default_image();
        if image.is_file() {
            return Ok(image);
        }
        let places: Vec<_> = installed
            .iter()
            .map(|image| image.display().to_string())
            .collect();
        Err(Failure::say(
            Cause::NoConsole,
            format!(
                "there is no firmware image for the emulator: {}",
                image.display()
            ),
            format!(
                "in a checkout, `cargo xtask firmware --board virtual` builds one; name it with --image, or copy it to {}",
                places.join(" or ")
            ),
        ))
    }

    /// Where an image is that was installed with this program.
    fn installed() -> Vec<PathBuf> {
        let program = std::env::current_exe().unwrap_or_default();
        let folder = program.parent().unwrap_or(Path::new(""));
        let share = folder
            .parent()
            .unwrap_or(Path::new(""))
            .join("share/sutura");
        [folder, &share].map(|folder| folder.join(IMAGE)).into()
    }

    /// Builds the image of a checkout; without cargo nothing is done.
    fn build(root: &Path) -> Result<(), Failure> {
        // Its own output belongs to progress: stdout is for the result.
        let built = Command::new("cargo")
            .args(["xtask", "firmware", "--board", "virtual"])
            .current_dir(root)
            .stdout(Stdio::from(std::io::stderr()))
            .status();
        match built {
            Ok(status) if status.success() => Ok(()),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(()),
            _ => Err(Failure::say(
                Cause::NoConsole,
                "the firmware image cannot be built",
                "see above, and `cargo xtask setup`; or name an image with --image",
            )),
        }
    }

    /// A failed emulator with its exit code and the next step.
    pub fn failure(error: QemuError) -> Failure {
        let help = match &error {
            QemuError::NoQemu => "run `cargo xtask setup`, or use `--console virtual`",
            QemuError::NoImage { .. } => {
                "run `cargo xtask firmware --board virtual`, or name an image with --image"
            }
            _ => {
                "run again with -v; `--console virtual --lockstep` does the same without the emulator"
            }
        };
        Failure::say(Cause::NoConsole, error.to_string(), help)
    }
}
