//! Links whose console goes away and comes back, several links at once, and a console that another host uses.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use sutura_host::link::{
    Heard, Link, LinkError, LinkOptions, Order, PipeEnd, Port, Standing, pipe,
};
use sutura_shared::device::{DeviceDescription, Joint, Kinematics};
use sutura_shared::link::{ConsoleLink, HostEvent, HostLink, Identity};
use sutura_shared::simulated_console::{Pace, SimulatedConsole};
use sutura_shared::wire::MAX_FRAME;
use sutura_shared::wire::message::{Command, Mode, State};

/// Longer than any machine needs, shorter than anybody waits.
const LONG: Duration = Duration::from_secs(60);

fn device(name: &[u8; 16]) -> DeviceDescription {
    let joint = Joint {
        counts_per_unit: 1e5,
        zero_counts: 0,
        effort_per_amp: 4.0,
        max_current_a: 3.0,
        max_slew_per_s: 4000.0,
        max_speed_per_s: 2.0,
        inertia: 0.1,
        damping: 0.5,
        coulomb: 0.2,
    };
    DeviceDescription {
        name: *name,
        kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
        joints: [joint; 3],
        gravity_mass_kg: [0.0; 3],
        max_force_n: 5.0,
        max_power_w: 5.0,
        max_grip_speed_m_per_s: 1.0,
        actuation_delay_us: 1000,
    }
}

/// A console in a thread, about a tick a millisecond. Dropped, it is unplugged.
struct Plugged {
    stop: Arc<AtomicBool>,
    reset: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Plugged {
    fn new(mut port: PipeEnd, name: &'static [u8; 16]) -> Self {
        let (stop, reset) = (
            Arc::new(AtomicBool::new(false)),
            Arc::new(AtomicBool::new(false)),
        );
        let (stopped, was_reset) = (stop.clone(), reset.clone());
        let thread = std::thread::spawn(move || {
            let mut seed = 0;
            let mut boot = || {
                seed += 1;
                SimulatedConsole::new(&device(name), seed).unwrap()
            };
            let mut console = boot();
            let (mut chunk, mut up) = ([0; 4096], Vec::new());
            while !stopped.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(1));
                if was_reset.swap(false, Ordering::Relaxed) {
                    console = boot();
                }
                while let Ok(count @ 1..) = port.read(&mut chunk, Duration::ZERO) {
                    console.feed(&chunk[..count]);
                }
                console.tick(Pace::default());
                up.clear();
                console.drain(&mut up);
                let _ = port.write(&up);
            }
        });
        Plugged {
            stop,
            reset,
            thread: Some(thread),
        }
    }
}

impl Drop for Plugged {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

/// What a listener heard of the link itself.
#[derive(Debug, PartialEq)]
enum News {
    Lost,
    Reopened,
}

/// A socket into which a console can be plugged.
#[derive(Clone, Default)]
struct Socket(Arc<Mutex<Option<PipeEnd>>>);

impl Socket {
    fn plug(&self, name: &'static [u8; 16]) -> Plugged {
        let (host, console) = pipe();
        *self.0.lock().unwrap() = Some(host);
        Plugged::new(console, name)
    }

    /// A link that takes nothing for gone but what closes its line.
    fn open(&self) -> (Link, Receiver<News>) {
        self.open_with(LinkOptions {
            silent_after: LONG,
            ..LinkOptions::default()
        })
    }

    fn open_with(&self, options: LinkOptions) -> (Link, Receiver<News>) {
        let (say, news): (Sender<News>, _) = channel();
        let socket = self.0.clone();
        let connect = move || match socket.lock().unwrap().as_ref() {
            Some(end) => Ok(end.try_clone().unwrap()),
            None => Err(LinkError::NoPort {
                name: "socket".to_owned(),
                found: Vec::new().into(),
            }),
        };
        let listener = move |heard: Heard<'_>| {
            let _ = match heard {
                Heard::Event(_) | Heard::Sent(_) => Ok(()),
                Heard::Lost(_) => say.send(News::Lost),
                Heard::Reopened(_) => say.send(News::Reopened),
            };
        };
        let link = Link::open_with(connect, options, listener).unwrap();
        (link, news)
    }
}

fn wait_for(link: &Link, what: impl Fn(&State) -> bool) -> State {
    let deadline = Instant::now() + LONG;
    loop {
        let state = link.state(deadline).unwrap().expect("in time");
        if what(state.body()) {
            return *state.body();
        }
    }
}

const ARM: Order = Order::Command(Command::Arm);

#[test]
fn a_console_that_was_unplugged_is_found_again_and_rests_until_it_is_armed() {
    let socket = Socket::default();
    let console = socket.plug(b"first\0\0\0\0\0\0\0\0\0\0\0");
    let (link, news) = socket.open();
    link.order(ARM).unwrap();
    wait_for(&link, |state| state.mode == Mode::Armed);

    *socket.0.lock().unwrap() = None;
    drop(console);
    assert_eq!(news.recv_timeout(LONG), Ok(News::Lost));
    assert_eq!(link.standing(), Standing::Lost);
    link.check().unwrap();
    // What is said to nobody is not said to the next one.
    link.order(ARM).unwrap();
    assert!(news.recv_timeout(Duration::from_millis(250)).is_err());

    let _console = socket.plug(b"second\0\0\0\0\0\0\0\0\0\0");
    assert_eq!(news.recv_timeout(LONG), Ok(News::Reopened));
    assert_eq!(link.standing(), Standing::Open(2));
    assert_eq!(&link.console().device_name, b"second\0\0\0\0\0\0\0\0\0\0");
    let first = wait_for(&link, |state| state.mode != Mode::Boot);
    let later = wait_for(&link, |state| state.tick > first.tick + 100);
    assert_eq!((first.mode, later.mode), (Mode::Idle, Mode::Idle));
    link.order(ARM).unwrap();
    wait_for(&link, |state| state.mode == Mode::Armed);

    let counters = link.close();
    assert_eq!(counters.sessions, 2);
    assert!(counters.frames.frames_sent > 4 && counters.frames.frames_received > 100);
}

/// The port stays: only that nothing comes says that the session is gone.
#[test]
fn a_console_that_starts_anew_behind_its_port_gets_a_new_session() {
    let socket = Socket::default();
    let console = socket.plug(b"reset\0\0\0\0\0\0\0\0\0\0\0");
    // Long enough for this machine to let a console in a thread come to its turn, short enough to wait for.
    let (link, news) = socket.open_with(LinkOptions {
        silent_after: Duration::from_secs(5),
        ..LinkOptions::default()
    });
    link.order(ARM).unwrap();
    // It has been there for some time, not for a first state alone.
    let armed = wait_for(&link, |state| state.mode == Mode::Armed && state.tick > 500);
    console.reset.store(true, Ordering::Relaxed);
    assert_eq!(news.recv_timeout(LONG), Ok(News::Lost));
    assert_eq!(news.recv_timeout(LONG), Ok(News::Reopened));
    let state = wait_for(&link, |state| state.mode != Mode::Boot);
    assert_eq!(state.mode, Mode::Idle, "{armed:?}");
}

#[test]
fn two_consoles_at_once_have_nothing_in_common() {
    let sockets = [Socket::default(), Socket::default()];
    let _left = sockets[0].plug(b"left\0\0\0\0\0\0\0\0\0\0\0\0");
    let _right = sockets[1].plug(b"right\0\0\0\0\0\0\0\0\0\0\0");
    let [(left, _), (right, _)] = [sockets[0].open(), sockets[1].open()];
    assert_eq!(&left.console().device_name[..4], b"left");
    assert_eq!(&right.console().device_name[..5], b"right");
    left.order(ARM).unwrap();
    left.order(Order::Command(Command::StateEvery { ticks: 100 }))
        .unwrap();
    let before = right.counters();
    wait_for(&left, |state| state.mode == Mode::Armed && state.tick > 300);
    let idle = wait_for(&right, |state| state.tick > 300);
    assert_eq!(idle.mode, Mode::Idle);
    let (left, right) = (left.close(), right.close());
    assert!(right.frames.frames_received > before.frames.frames_received);
    let orders = |counters: &sutura_host::link::LinkCounters| {
        u64::from(counters.frames.frames_sent) - counters.pings_sent
    };
    // Hello, two orders, disarm; hello, disarm. A late writer's last order is not waited for.
    let (of_left, of_right) = (orders(&left), orders(&right));
    assert!((3..=4).contains(&of_left) && (1..=2).contains(&of_right));
    assert_eq!((left.sessions, right.sessions), (1, 1));
}

#[test]
fn the_answers_to_pings_make_a_clock() {
    let socket = Socket::default();
    let _console = socket.plug(b"clock\0\0\0\0\0\0\0\0\0\0\0");
    let (link, _news) = socket.open();
    let deadline = Instant::now() + LONG;
    while link.round_trips().count < 5 {
        assert!(Instant::now() < deadline, "no answers");
        std::thread::sleep(Duration::from_millis(10));
    }
    let clock = link.clock().unwrap();
    let trips = link.round_trips();
    assert!(
        trips.min <= trips.p50 && trips.p50 <= trips.max,
        "{trips:?}"
    );
    assert_eq!(clock.uncertainty_us, 0.5 * trips.min);
    assert!(clock.host_us <= link.host_us() as f64);
}

/// Another host's frames keep coming in, as over a second line to the same console.
#[test]
fn a_console_that_another_host_uses_says_so() {
    let (host, mut far) = pipe();
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let console = std::thread::spawn(move || {
        let identity = Identity {
            tick_hz: 1000,
            simulated: true,
            device_name: *b"shared\0\0\0\0\0\0\0\0\0\0",
        };
        let (mut end, mut owner) = (ConsoleLink::new(identity, 1), HostLink::new(1000));
        let (mut frame, mut chunk) = ([0; MAX_FRAME], [0; 256]);
        let length = owner.hello(1, &mut frame).unwrap();
        end.receive(&mut &frame[..length], 0);
        let length = end.take_reply(0, &mut frame).unwrap();
        assert!(
            frame[..length]
                .iter()
                .any(|byte| matches!(owner.receive(*byte), Some(HostEvent::Opened(_))))
        );
        let length = owner.send(0, &Command::Arm, &mut frame).unwrap();
        end.receive(&mut &frame[..length], 0);
        while !stopped.load(Ordering::Relaxed) {
            let count = far.read(&mut chunk, Duration::from_millis(1)).unwrap_or(0);
            let mut rest = &chunk[..count];
            while end.receive(&mut rest, 1000).is_some() {}
            if let Some(length) = end.take_reply(1000, &mut frame) {
                let _ = far.write(&frame[..length]);
            }
        }
    });
    let options = LinkOptions {
        answer_within: Duration::from_millis(300),
        ..LinkOptions::default()
    };
    let Err(error) = Link::open(Box::new(host), options, |_| {}) else {
        panic!("opened");
    };
    stop.store(true, Ordering::Relaxed);
    console.join().unwrap();
    assert!(matches!(error, LinkError::Owned { .. }), "{error:?}");
    assert!(error.to_string().contains("in use by another host"));
}
