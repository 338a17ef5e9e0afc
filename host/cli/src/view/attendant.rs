//! Who looks after a console in real time where there is a page: what it asks for goes out at once.
//!
//! Entry point: [`PageAttendant`].

use super::guide::{Guide, NO_WAY, NO_WAY_HELP, NOT_HELD, PERIOD_S};
use super::helm::{NO_JAWS, NO_JAWS_HELP};
use super::saves::Saves;
use super::take_out::{IS_CLEAR, MORE_WAYS, NoWay, RESTS_S, STILL_INSIDE, Start, TakeOut};
use super::telemetry::Telemetry;
use crate::attendant::Operator;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};
use sutura_host::link::{LinkError, Order};
use sutura_host::session::{Arms, Attendant, Stop};
use sutura_host::tool::Act;
use sutura_shared::wire::message::{Command as ToConsole, Simulate};
use sutura_view::{Command, Hand, Request};

/// Commands that work in real time: on any console, and besides on one that is simulated.
pub const COMMANDS: [&str; 5] = ["scalar", "safe_stop", "arm", "clear_fault", "save_last"];
/// On a console whose tool has jaws.
pub const JAWS: &str = "jaws";
/// On a simulated console whose tool touches.
pub const TAKE_OUT: &str = "take_out";
/// See [`COMMANDS`].
pub const SIMULATED: [&str; 2] = ["drag", "hand"];

/// Time in which a console that decays comes to rest: an order to arm that finds none at rest by then is forgotten.
const ARMS_WITHIN: Duration = Duration::from_secs(1);

/// An [`Operator`] who is asked by a page, too.
pub struct PageAttendant {
    operator: Operator,
    asked: Receiver<Request>,
    /// Time at which a page asked to arm a console that was not armed. It counts for [`ARMS_WITHIN`].
    arms: Option<Instant>,
    /// Whether a page has stopped it, and none has armed it since: then it is not armed by itself.
    is_stopped: bool,
    /// Requests for rest that are not reported yet, with the names of the persons.
    stops: Vec<(Stop, String)>,
    /// Of a simulated console: its hand, and since when.
    hand: Option<(Guide, Instant)>,
    saves: Saves,
    /// The console's tool, if that has jaws, and what is done with it before the next solve.
    jaws: Option<u8>,
    acts: Vec<Act>,
    /// Ways out of the tissue for a simulated console's tool.
    out: Option<TakeOut>,
    /// End of the way out that it is on, and the number of further ones; then the console is armed.
    leaving: Option<(Instant, u8)>,
    /// Orders that go out with the next waits.
    orders: VecDeque<Order>,
    /// Shared state that tells the page the name of the person who stopped it.
    telemetry: Arc<Telemetry>,
}

impl PageAttendant {
    /// Beside an operator; `hand` of a simulated console, and the ways out of the tissue for its tool; `jaws`: the console's
    /// tool, if that has any.
    pub fn new(
        operator: Operator,
        asked: Receiver<Request>,
        (hand, out): (Option<Guide>, Option<TakeOut>),
        (saves, telemetry): (Saves, Arc<Telemetry>),
        jaws: Option<u8>,
    ) -> Self {
        Self {
            operator,
            asked,
            arms: None,
            is_stopped: false,
            stops: Vec::new(),
            hand: hand.map(|hand| (hand, Instant::now())),
            saves,
            jaws,
            acts: Vec::new(),
            out,
            leaving: None,
            orders: VecDeque::new(),
            telemetry,
        }
    }

    /// Begins a way out of the tissue, with at most `more` after it. Returns whether there is one: none for a tool that is clear.
    fn leave(&mut self, start: Start, more: u8) -> Result<bool, NoWay> {
        let (Some(out), Some((guide, since))) = (&self.out, &mut self.hand) else {
            let message = "the tool of this console is not this page's to move";
            return Err((message.to_owned(), "take it out by hand, then arm"));
        };
        let Some(grip) = self.telemetry.grip() else {
            return Err(("the console has said nothing yet".to_owned(), "wait for it"));
        };
        let now_s = since.elapsed().as_secs_f64();
        // The last solve was before the first way.
        let slipped = matches!(start, Start::Grip) && self.telemetry.has_slipped();
        let Some((script, way_s)) = out.way(guide, now_s, &grip, start, slipped)? else {
            return Ok(false);
        };
        self.orders
            .push_back(Order::Simulate(Simulate::Hand(script)));
        let ends = Instant::now() + Duration::from_secs_f64(way_s + RESTS_S);
        self.leaving = Some((ends, more));
        Ok(true)
    }

    /// Whether the page may move the grip: at rest nobody holds it.
    fn moves(&mut self) -> bool {
        let renders = self.telemetry.renders();
        let guide = self.hand.as_mut().map(|(guide, _)| guide);
        guide.is_some_and(|guide| guide.moves(renders))
    }

    fn obey(&mut self, Request { command, reply }: Request) -> Option<Order> {
        let moves = self.moves();
        let order = match command {
            Command::SafeStop => {
                self.stops.push((Stop::Safe, reply.person()));
                (self.arms, self.is_stopped) = (None, true);
                let is_led = self.leaving.take().is_some();
                if let Some((guide, since)) = &mut self.hand {
                    if let Some(grip) = self.telemetry.grip().filter(|_| is_led) {
                        let script = guide.stay(since.elapsed().as_secs_f64(), grip.position_m);
                        self.orders
                            .push_back(Order::Simulate(Simulate::Hand(script)));
                    }
                    guide.stop();
                }
                self.telemetry.safe_stop(reply.asker());
                Some(Order::Command(ToConsole::Disarm))
            }
            Command::ClearFault => Some(Order::Command(ToConsole::ClearFault)),
            Command::Arm => {
                // One that is armed already needs nothing, now or later.
                let arms = self.is_stopped || !self.telemetry.is_armed();
                if let Some((guide, _)) = &mut self.hand {
                    guide.arm();
                }
                self.arms = arms.then(Instant::now);
                (self.is_stopped, self.leaving) = (false, None);
                self.telemetry.arm();
                None
            }
            Command::TakeOut => match self.leave(Start::Grip, MORE_WAYS) {
                Ok(true) => {
                    self.telemetry.take_out();
                    self.stops.push((Stop::TakeOut, reply.person()));
                    (self.arms, self.is_stopped) = (None, true);
                    Some(Order::Command(ToConsole::Disarm))
                }
                Ok(false) => {
                    let (message, help) = IS_CLEAR;
                    reply.refuse(message, help);
                    return None;
                }
                Err((message, help)) => {
                    reply.refuse(&message, help);
                    return None;
                }
            },
            Command::Drag(Some(_)) | Command::Hand(_) if !moves => {
                let (message, help) = NOT_HELD;
                reply.refuse(message, help);
                return None;
            }
            Command::Drag(to_m) => {
                if let Some((guide, since)) = &mut self.hand {
                    guide.drag(since.elapsed().as_secs_f64(), to_m);
                }
                None
            }
            Command::Hand(hand) => {
                let guide = self.hand.as_mut();
                if hand == Hand::Recorded && guide.as_ref().is_some_and(|(g, _)| !g.has_way()) {
                    reply.refuse(NO_WAY, NO_WAY_HELP);
                    return None;
                }
                guide.map(|(guide, since)| {
                    let script = guide.go(since.elapsed().as_secs_f64(), hand);
                    Order::Simulate(Simulate::Hand(script))
                })
            }
            Command::Jaws(closed) => {
                let Some(tool) = self.jaws else {
                    reply.refuse(NO_JAWS, NO_JAWS_HELP);
                    return None;
                };
                self.acts.push(Act::of_jaws(tool, closed));
                None
            }
            Command::SaveLast => {
                self.saves.last(reply);
                return None;
            }
            _ => None,
        };
        reply.done();
        order
    }
}

impl Attendant for PageAttendant {
    fn lost(&mut self, why: &LinkError) {
        self.operator.lost(why);
    }

    fn back(&mut self) {
        self.operator.back();
    }

    fn let_go(&mut self, wait: Duration) {
        self.operator.let_go(wait);
    }

    fn stopped(&mut self, stop: Stop, person: &str) {
        self.operator.stopped(stop, person);
    }

    fn stops(&mut self) -> Vec<(Stop, String)> {
        std::mem::take(&mut self.stops)
    }

    fn arms(&mut self) -> Arms {
        if let Some((_, more)) = self.leaving.take_if(|(ends, _)| Instant::now() >= *ends) {
            match self.leave(Start::Hand, more.saturating_sub(1)) {
                Ok(false) => {
                    self.is_stopped = false;
                    return Arms::ByHand;
                }
                Ok(true) if more > 0 => {}
                Ok(true) | Err(_) => {
                    self.leaving = None;
                    note!("{STILL_INSIDE}");
                }
            }
        }
        if self
            .arms
            .take()
            .is_some_and(|then| then.elapsed() < ARMS_WITHIN)
        {
            return Arms::ByHand;
        }
        match self.operator.arms() {
            Arms::ByItself if self.is_stopped => Arms::No,
            arms => arms,
        }
    }

    fn wait(&mut self, most: Duration) -> Option<Order> {
        let until = Instant::now() + most;
        if let Some(order) = self.orders.pop_front() {
            return Some(order);
        }
        loop {
            let moves = self.moves();
            let hand = self.hand.as_mut().filter(|_| moves);
            let order = hand.and_then(|(guide, since)| {
                let script = guide.order(since.elapsed().as_secs_f64())?;
                Some(Order::Simulate(Simulate::Hand(script)))
            });
            if order.is_some() {
                return order;
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            let wait = left.min(Duration::from_secs_f64(PERIOD_S));
            match self.asked.recv_timeout(wait) {
                Ok(request) => {
                    let order = self.obey(request);
                    if order.is_some() || !self.acts.is_empty() {
                        return order;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(wait),
            }
        }
    }

    fn acts(&mut self) -> Vec<Act> {
        std::mem::take(&mut self.acts)
    }

    fn stays(&self) -> bool {
        true
    }
}
