//! The host's link against a console's end of the link in a thread, over a pipe in memory.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};
use sutura_client::link::{
    Felt, Heard, Link, LinkError, LinkOptions, Order, PipeEnd, Port, SentContact, pipe,
};
use sutura_shared::link::{ConsoleLink, HostEvent, Identity, LinkEvent, Mismatch};
use sutura_shared::wire::message::{
    Command, Contact, Course, End, Friction, Mode, Needle, Row, Rows, State, Tension, Thread, Tip,
};
use sutura_shared::wire::{List, MAX_FRAME};

/// Longer than any machine needs, shorter than anybody waits.
const LONG: Duration = Duration::from_secs(60);

const IDENTITY: Identity = Identity {
    tick_hz: 1000,
    simulated: false,
    device_name: *b"bench\0\0\0\0\0\0\0\0\0\0\0",
};

fn state(tick: u32) -> State {
    State {
        tick,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        velocity_m_per_s: [0.0; 3],
        force_n: [0.0; 3],
        current_a: [0.0; 3],
        mode: Mode::Idle,
        faults: 0,
        contact_sequence: 0,
        contact_age_us: u32::MAX,
        applied_age_us: 0,
        trace_hash: 0,
        encoder_counts: [0; 3],
        inputs: 0,
        heard_sequence: 0,
    }
}

fn contact(tool: u8) -> Contact {
    Contact {
        tool,
        position_m: [0.0; 3],
        orientation: [0.0, 0.0, 0.0, 1.0],
        wrench: [0.0; 6],
        tangent: [0.0; 21],
        gap_m: 0.0,
        normal: [0.0, 0.0, 1.0],
        relaxation_per_s: 0.0,
        horizon_us: 50_000,
    }
}

fn needle(number: u8) -> Needle {
    Needle {
        tool: 0,
        needle: number,
        slide: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        tip: Tip::Outside,
        friction: Friction::Sticks,
        axial_n: 0.0,
        friction_n: [0.0; 2],
        stiffness_n_per_m: [0.0; 2],
        hold_n: 0.0,
        puncture_n: 1.0,
        punctured_n: 0.0,
        course: Course::default(),
    }
}

fn thread(number: u8) -> Thread {
    Thread {
        tool: 0,
        thread: number,
        end: End::Tail,
        state: Tension::Slack,
        direction: [0.0, 0.0, 1.0],
        tension_n: 0.0,
        stiffness_n_per_m: 50.0,
        slack_m: 0.1,
    }
}

/// One row.
fn rows() -> Rows {
    Rows {
        tool: 3,
        held: [0.0; 21],
        curvature_per_m: 0.0,
        rows: List::of([Row::default()]),
        compliance: List::of([0.01]),
    }
}

/// A contact alone.
fn felt(contact: Contact) -> Felt {
    Felt {
        contact,
        rows: None,
        needle: None,
        thread: None,
    }
}

/// What the test tells the console to do.
enum Do {
    /// Send this many states at once, with one write.
    States(u32),
    /// Send bytes that are no frame.
    Noise(Vec<u8>),
    /// Take in what came, then say so.
    Hear(Sender<()>),
    /// Close the line.
    Leave,
}

/// A console that answers hellos by itself and reports what it heard.
fn console(mut port: PipeEnd, orders: &Receiver<Do>, heard: &Sender<LinkEvent>) {
    let mut end = ConsoleLink::new(IDENTITY, 7);
    let (mut frame, mut chunk, mut tick) = ([0; MAX_FRAME], [0; 256], 0);
    loop {
        let count = port.read(&mut chunk, Duration::from_millis(1)).unwrap_or(0);
        let mut rest = &chunk[..count];
        while let Some(event) = end.receive(&mut rest, 1_000_000) {
            let _ = heard.send(event);
        }
        if let Some(length) = end.take_reply(0, &mut frame) {
            port.write(&frame[..length]).unwrap();
        }
        match orders.try_recv() {
            Ok(Do::States(count)) => {
                let mut bytes = Vec::new();
                for _ in 0..count {
                    tick += 1;
                    let length = end.encode_state(u64::from(tick) * 1000, &state(tick), &mut frame);
                    bytes.extend_from_slice(&frame[..length]);
                }
                assert_eq!(port.write(&bytes).unwrap(), bytes.len());
            }
            Ok(Do::Noise(bytes)) => assert_eq!(port.write(&bytes).unwrap(), bytes.len()),
            Ok(Do::Hear(done)) => done.send(()).unwrap(),
            Ok(Do::Leave) => return,
            Err(std::sync::mpsc::TryRecvError::Empty) => {}
            Err(std::sync::mpsc::TryRecvError::Disconnected) => return,
        }
    }
}

struct Bench {
    link: Link,
    tell: Sender<Do>,
    heard: Receiver<LinkEvent>,
    events: Receiver<HostEvent>,
}

fn bench() -> Bench {
    bench_over(|host| Box::new(host), LinkOptions::default())
}

fn bench_over(port: impl FnOnce(PipeEnd) -> Box<dyn Port>, options: LinkOptions) -> Bench {
    let (host, far) = pipe();
    let (tell, orders) = channel();
    let (say, heard) = channel();
    std::thread::spawn(move || console(far, &orders, &say));
    let (listen, events) = channel();
    let listener = move |event: &HostEvent| {
        let _ = listen.send(*event);
    };
    let link = Link::open(port(host), options, listener).unwrap();
    assert_eq!(heard.recv_timeout(LONG), Ok(LinkEvent::SessionOpened));
    Bench {
        link,
        tell,
        heard,
        events,
    }
}

#[test]
fn the_newest_state_wins_and_the_listener_hears_all() {
    let bench = bench();
    assert!(!bench.link.console().simulated);
    bench.tell.send(Do::States(5)).unwrap();
    for tick in 1..=5 {
        let HostEvent::State(state) = bench.events.recv_timeout(LONG).unwrap() else {
            panic!()
        };
        assert_eq!(state.body().tick, tick);
    }
    // The slot gets a state right after the listener does.
    let mut newest = 0;
    while newest < 5 {
        newest = bench
            .link
            .state(Instant::now() + LONG)
            .unwrap()
            .unwrap()
            .body()
            .tick;
    }
    let counters = bench.link.counters();
    assert_eq!(
        (counters.frames.frames_lost, counters.frames.frames_rejected),
        (0, 0)
    );
    // The hello's answer and five states.
    assert_eq!(counters.frames.frames_received, 6);
    assert!(counters.states_superseded <= 4);
    assert!(
        bench.link.state(Instant::now()).unwrap().is_none(),
        "each state is taken once"
    );
}

#[test]
fn noise_costs_frames_but_not_the_session() {
    let bench = bench();
    bench
        .tell
        .send(Do::Noise(vec![1, 2, 3, 0, 255, 0, 0]))
        .unwrap();
    bench.tell.send(Do::States(1)).unwrap();
    let state = bench.link.state(Instant::now() + LONG).unwrap().unwrap();
    assert_eq!(state.body().tick, 1);
    let counters = bench.link.counters().frames;
    assert_eq!((counters.frames_rejected, counters.frames_lost), (2, 0));
}

#[test]
fn orders_arrive_in_order_and_a_closing_link_disarms_last() {
    let bench = bench();
    for command in [Command::ClearFault, Command::Arm] {
        bench.link.order(Order::Command(command)).unwrap();
    }
    let sent = bench.link.close();
    let heard: Vec<Command> = (0..3)
        .map(|_| match bench.heard.recv_timeout(LONG).unwrap() {
            LinkEvent::Command(command) => *command.body(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(heard, [Command::ClearFault, Command::Arm, Command::Disarm]);
    // With the hello; a writer that this machine let wait for half a second is not waited for.
    let frames = u64::from(sent.frames.frames_sent);
    assert!(frames - sent.pings_sent <= 4, "{sent:?}");
}

#[test]
fn a_contact_that_the_console_would_refuse_is_not_sent() {
    let bench = bench();
    let mut bad = contact(0);
    bad.wrench[2] = f32::NAN;
    bench.link.felt(1000, felt(bad));
    let (done, ready) = channel();
    bench.tell.send(Do::Hear(done)).unwrap();
    ready.recv_timeout(LONG).unwrap();
    bench.link.order(Order::Command(Command::Arm)).unwrap();
    bench.link.felt(1000, felt(contact(3)));
    let mut heard = Vec::new();
    while heard.len() < 2 {
        heard.push(bench.heard.recv_timeout(LONG).unwrap());
    }
    let is_arm = |event: &LinkEvent| matches!(event, LinkEvent::Command(command) if *command.body() == Command::Arm);
    assert!(heard.iter().any(is_arm));
    let tools: Vec<u8> = heard
        .iter()
        .filter_map(|event| {
            if let LinkEvent::Contact(contact) = event {
                Some(contact.body().tool)
            } else {
                None
            }
        })
        .collect();
    assert_eq!(tools, [3]);
}

#[test]
fn rows_needle_and_thread_go_just_before_their_contact() {
    let bench = bench();
    let felt = Felt {
        rows: Some(rows()),
        needle: Some(needle(5)),
        thread: Some(thread(6)),
        ..felt(contact(3))
    };
    bench.link.felt(1000, felt);
    let next = || bench.heard.recv_timeout(LONG).unwrap();
    let heard = [next(), next(), next(), next()];
    let [
        LinkEvent::Rows,
        LinkEvent::Needle(needle),
        LinkEvent::Thread(thread),
        LinkEvent::Contact(contact),
    ] = &heard
    else {
        panic!("{heard:?}");
    };
    assert_eq!(thread.body().thread, 6);
    assert_eq!(thread.console_time_us(), 1000);
    assert_eq!((needle.body().needle, contact.body().tool), (5, 3));
    assert_eq!(
        (needle.console_time_us(), contact.console_time_us()),
        (1000, 1000)
    );
    let sent = bench.link.close();
    assert_eq!(sent.contacts_sent, 1);
    // Hello, rows, needle, thread, contact, and a disarm for which it may not have waited.
    let frames = u64::from(sent.frames.frames_sent) - sent.pings_sent;
    assert!((5..=6).contains(&frames), "{sent:?}");
}

/// A port that takes this many bytes at a time.
struct Narrow(Box<dyn Port>, usize);

impl Port for Narrow {
    fn name(&self) -> String {
        self.0.name()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> std::io::Result<usize> {
        self.0.read(into, wait)
    }

    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(&bytes[..bytes.len().min(self.1)])
    }

    fn try_clone(&self) -> std::io::Result<Box<dyn Port>> {
        Ok(Box::new(Narrow(self.0.try_clone()?, self.1)))
    }
}

#[test]
fn what_is_written_at_once_is_whole_and_in_order_on_a_narrow_line_too() {
    for width in [usize::MAX, 10] {
        let options = LinkOptions {
            at_once: true,
            ..LinkOptions::default()
        };
        let bench = bench_over(move |host| Box::new(Narrow(Box::new(host), width)), options);
        for tool in 0..8 {
            bench.link.felt(1000, felt(contact(tool)));
            // Nothing is replaced: the next one waits for this one.
            let heard = bench.heard.recv_timeout(LONG).unwrap();
            assert!(
                matches!(&heard, LinkEvent::Contact(contact) if contact.body().tool == tool),
                "{heard:?}"
            );
        }
        let mut bad = contact(0);
        bad.wrench[2] = f32::NAN;
        bench.link.felt(1000, felt(bad));
        bench.link.order(Order::Command(Command::Arm)).unwrap();
        let heard = bench.heard.recv_timeout(LONG).unwrap();
        assert!(
            matches!(&heard, LinkEvent::Command(command) if *command.body() == Command::Arm),
            "{heard:?}"
        );
        let sent = bench.link.close();
        assert_eq!((sent.contacts_sent, sent.contacts_superseded), (8, 0));
        // Hello, arm, disarm.
        let frames = u64::from(sent.frames.frames_sent);
        assert_eq!(frames - sent.pings_sent, 8 + 3);
    }
}

#[test]
fn a_state_of_a_tick_is_waited_for() {
    let bench = bench();
    bench.tell.send(Do::States(20)).unwrap();
    let state = bench
        .link
        .state_from(Some(15), Instant::now() + LONG)
        .unwrap();
    assert!(state.unwrap().body().tick >= 15);
    bench.tell.send(Do::States(1)).unwrap();
    // One that does not come: in the end the newest that there is.
    let newest = loop {
        let soon = Instant::now() + Duration::from_millis(1);
        if let Some(state) = bench.link.state_from(Some(1000), soon).unwrap()
            && state.body().tick > 20
        {
            break state.body().tick;
        }
    };
    assert_eq!(newest, 21);
}

#[test]
fn a_link_that_did_not_ask_got_nothing() {
    use sutura_client::scheduling::Granted;
    assert_eq!(bench().link.granted(), Granted::NotAsked);
    let options = LinkOptions {
        real_time: true,
        ..LinkOptions::default()
    };
    let bench = bench_over(|host| Box::new(host), options);
    // Whatever this user may have.
    assert_ne!(bench.link.granted(), Granted::NotAsked);
}

/// With the number that it has on the line, and before a state that could know of it; what was not sent is not told.
#[test]
fn the_listener_hears_what_went_out_before_the_console_can_tell() {
    /// What the listener hears.
    #[derive(Debug, PartialEq)]
    enum News {
        Sent(SentContact),
        State(u32),
    }
    let (host, far) = pipe();
    let (tell, orders) = channel();
    let (say, heard) = channel();
    std::thread::spawn(move || console(far, &orders, &say));
    let (listen, news) = channel();
    let listener = move |heard: Heard<'_>| {
        let news = match heard {
            Heard::Sent(sent) => News::Sent(sent),
            Heard::Event(HostEvent::State(state)) => News::State(state.body().tick),
            _ => return,
        };
        let _ = listen.send(news);
    };
    let link = Link::open_heard(Box::new(host), LinkOptions::default(), listener).unwrap();
    assert_eq!(heard.recv_timeout(LONG), Ok(LinkEvent::SessionOpened));
    let mut expected = Vec::new();
    for round in 1..=3 {
        let mut bad = contact(0);
        bad.gap_m = f32::NAN;
        link.felt(9000, felt(bad));
        link.order(Order::Command(Command::Arm)).unwrap();
        while !matches!(heard.recv_timeout(LONG).unwrap(), LinkEvent::Command(_)) {}
        let console_time_us = 1000 * u64::from(round);
        let felt = Felt {
            needle: Some(needle(5)),
            ..felt(contact(0))
        };
        link.felt(console_time_us, felt);
        let sequence = loop {
            if let LinkEvent::Contact(contact) = heard.recv_timeout(LONG).unwrap() {
                assert_eq!(contact.console_time_us(), console_time_us);
                break contact.sequence();
            }
        };
        tell.send(Do::States(1)).unwrap();
        expected.push(News::Sent(SentContact {
            sequence,
            console_time_us,
            horizon_us: 50_000,
        }));
        expected.push(News::State(round));
        while heard.try_recv().is_ok() {}
        // So that the next round's contact does not come before this state.
        let told: Vec<_> = (0..2).map(|_| news.recv_timeout(LONG).unwrap()).collect();
        assert_eq!(told, expected[expected.len() - 2..]);
    }
}

#[test]
fn a_console_that_leaves_is_noticed() {
    let bench = bench();
    bench.tell.send(Do::Leave).unwrap();
    let gone = bench.link.state(Instant::now() + LONG);
    assert!(
        matches!(&gone, Err(LinkError::Gone { reason, .. }) if reason.contains("closed")),
        "{gone:?}"
    );
    assert!(matches!(
        bench.link.order(Order::Command(Command::Arm)),
        Err(LinkError::Gone { .. })
    ));
}

#[test]
fn silence_is_no_answer() {
    let (host, _far) = pipe();
    let options = LinkOptions {
        answer_within: Duration::from_millis(20),
        ..LinkOptions::default()
    };
    let Err(error) = Link::open(Box::new(host), options, |_| {}) else {
        panic!("opened")
    };
    assert!(matches!(error, LinkError::NoAnswer { .. }), "{error:?}");
    assert!(error.to_string().contains("nothing came"), "{error}");
}

#[test]
fn a_console_at_another_rate_is_refused() {
    let (host, far) = pipe();
    let (_tell, orders) = channel();
    let (say, _heard) = channel();
    std::thread::spawn(move || console(far, &orders, &say));
    let options = LinkOptions {
        tick_hz: 4000,
        ..LinkOptions::default()
    };
    let Err(error) = Link::open(Box::new(host), options, |_| {}) else {
        panic!("opened")
    };
    let LinkError::Mismatch { mismatch, .. } = &error else {
        panic!("{error:?}")
    };
    assert_eq!(
        *mismatch,
        Mismatch::TickRate {
            console: 1000,
            host: 4000
        }
    );
}
