//! Connections that have not given the key: how many there are, and which one goes for a new one.
//!
//! Entry points: [`Waiting::enter`], [`Guest`]. A newcomer is always let in, so that nobody can shut others out by keeping
//! connections; with too many the oldest goes that has not even asked for anything.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

/// Most connections without the key at once. A page opens six at a time for its files.
pub const MOST_WAITING: usize = 64;
/// Longest time for the head of a request, from its first moment.
pub const HEADER_WITHIN: Duration = Duration::from_secs(5);
/// Longest time of a connection without a new request, its answer included.
const IDLE: Duration = Duration::from_secs(30);

/// Connections that have not given the key.
#[derive(Debug, Default)]
pub struct Waiting(Mutex<Room>);

#[derive(Debug, Default)]
struct Room {
    /// By age: the first is the oldest.
    guests: BTreeMap<u64, Arc<Seat>>,
    next: u64,
}

/// State of a connection.
#[derive(Debug)]
struct Seat {
    /// Whether a request of it is being answered.
    asks: AtomicBool,
    /// Time of its last request, or of its opening.
    asked: Mutex<Instant>,
    dismissed: Notify,
}

/// A connection. Dropped, or with the key, it no longer counts.
#[derive(Debug)]
pub struct Guest {
    waiting: Arc<Waiting>,
    number: u64,
    seat: Arc<Seat>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Waiting {
    /// Lets a connection in. Dismisses another one where there are too many: the oldest that does not ask for anything, else
    /// the oldest.
    pub fn enter(self: &Arc<Self>) -> Guest {
        let mut room = lock(&self.0);
        if room.guests.len() >= MOST_WAITING {
            let silent = room
                .guests
                .iter()
                .find(|(_, seat)| !seat.asks.load(Ordering::Relaxed));
            let goes = silent.or(room.guests.first_key_value());
            if let Some(number) = goes.map(|(number, _)| *number)
                && let Some(seat) = room.guests.remove(&number)
            {
                seat.dismissed.notify_one();
            }
        }
        let number = room.next;
        room.next += 1;
        let seat = Arc::new(Seat {
            asks: AtomicBool::new(false),
            asked: Mutex::new(Instant::now()),
            dismissed: Notify::new(),
        });
        room.guests.insert(number, seat.clone());
        Guest {
            waiting: self.clone(),
            number,
            seat,
        }
    }
}

impl Guest {
    /// A request has come, and is being answered.
    pub fn asks(&self) {
        *lock(&self.seat.asked) = Instant::now();
        self.seat.asks.store(true, Ordering::Relaxed);
    }

    /// It has been answered.
    pub fn is_answered(&self) {
        self.seat.asks.store(false, Ordering::Relaxed);
    }

    /// It has the key, and no longer counts.
    pub fn has_key(&self) {
        lock(&self.waiting.0).guests.remove(&self.number);
    }

    /// Waits until it has to go for another one.
    pub async fn dismissed(&self) {
        self.seat.dismissed.notified().await;
    }

    /// Waits until it has not asked for anything for too long.
    pub async fn idle(&self) {
        loop {
            let until = *lock(&self.seat.asked) + IDLE;
            if until <= Instant::now() {
                return;
            }
            sleep_until(until).await;
        }
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        self.has_key();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether each of them has been dismissed.
    fn dismissed(guests: &[Guest]) -> Vec<bool> {
        let number = |guest: &Guest| guest.number;
        let room = lock(&guests[0].waiting.0);
        let is_gone = |guest| !room.guests.contains_key(&number(guest));
        guests.iter().map(is_gone).collect()
    }

    /// Beyond this number the oldest idle connection is closed. Connections with the key are not counted.
    #[test]
    fn a_newcomer_takes_the_place_of_the_oldest_that_is_silent() {
        let waiting = Arc::new(Waiting::default());
        let mut guests: Vec<Guest> = (0..MOST_WAITING).map(|_| waiting.enter()).collect();
        assert!(dismissed(&guests).iter().all(|is| !is));
        guests[0].asks();
        guests[2].has_key();
        guests.push(waiting.enter());
        assert_eq!(dismissed(&guests)[..4], [false, false, true, false]);
        guests.push(waiting.enter());
        assert_eq!(dismissed(&guests)[..4], [false, true, true, false]);
        guests[0].is_answered();
        guests.push(waiting.enter());
        assert_eq!(dismissed(&guests)[..4], [true, true, true, false]);
        // All of them ask: the oldest all the same.
        guests.iter().for_each(Guest::asks);
        guests.push(waiting.enter());
        assert_eq!(dismissed(&guests)[..5], [true, true, true, true, false]);
        // A connection that ends makes room.
        guests.pop();
        guests.push(waiting.enter());
        assert_eq!(dismissed(&guests)[4..], [false; MOST_WAITING]);
    }
}
