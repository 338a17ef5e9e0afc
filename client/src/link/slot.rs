//! What threads hand to each other: newest values and bounded orders.
//!
//! Entry points: [`Slot`] for real-time data, where an old value is worth nothing; [`Outbox`] for
//! all that waits to be written, where orders are never dropped silently.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// A lock that outlives a panicking thread: the data are plain values, always whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Holds at most one value, of some tick; a newer one replaces it. One thread waits at a time.
#[derive(Debug)]
pub struct Slot<T> {
    inner: Mutex<Inner<T>>,
    changed: Condvar,
}

#[derive(Debug)]
struct Inner<T> {
    value: Option<(u32, T)>,
    /// The tick that is waited for; any if none is.
    wanted: Option<u32>,
    closed: bool,
    superseded: u64,
}

impl<T> Default for Slot<T> {
    fn default() -> Self {
        let inner = Inner {
            value: None,
            wanted: None,
            closed: false,
            superseded: 0,
        };
        Slot {
            inner: Mutex::new(inner),
            changed: Condvar::new(),
        }
    }
}

/// Whether `tick` is `wanted` or after it. Ticks wrap around.
fn is_from(tick: u32, wanted: Option<u32>) -> bool {
    wanted.is_none_or(|wanted| tick.wrapping_sub(wanted) <= u32::MAX / 2)
}

impl<T> Slot<T> {
    /// Puts the value of a tick in, in place of one that nobody took. Wakes nobody who waits for a later tick: a wake-up
    /// on a busy machine may be late, and then so is the one that counts.
    ///
    /// Whether it wakes whoever waits.
    pub fn put(&self, tick: u32, value: T) -> bool {
        let mut inner = lock(&self.inner);
        if inner.value.replace((tick, value)).is_some() {
            inner.superseded += 1;
        }
        let wakes = is_from(tick, inner.wanted);
        drop(inner);
        if wakes {
            self.changed.notify_one();
        }
        wakes
    }

    /// Takes the value of that tick or a later one (any if none is given), waiting for it until `deadline`. When time is up
    /// or the slot is closed: what there is, whatever its tick.
    pub fn wait_for(&self, tick: Option<u32>, deadline: Instant) -> Option<T> {
        let mut inner = lock(&self.inner);
        loop {
            let there = inner.value.as_ref();
            let left = deadline.saturating_duration_since(Instant::now());
            if there.is_some_and(|(of, _)| is_from(*of, tick)) || inner.closed || left.is_zero() {
                inner.wanted = None;
                return inner.value.take().map(|(_, value)| value);
            }
            inner.wanted = tick;
            inner = self
                .changed
                .wait_timeout(inner, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
    }

    /// Drops the value that nobody took.
    pub fn clear(&self) {
        lock(&self.inner).value = None;
    }

    /// Wakes whoever waits; nobody waits on this slot again.
    pub fn close(&self) {
        lock(&self.inner).closed = true;
        self.changed.notify_all();
    }

    /// How many values were replaced before anybody took them.
    pub fn superseded(&self) -> u64 {
        lock(&self.inner).superseded
    }
}

/// What [`Outbox::next`] hands to the writer.
#[derive(Debug, PartialEq, Eq)]
pub enum Outgoing<O, T> {
    /// The oldest order.
    Order(O),
    /// The newest real-time value.
    Latest(T),
    /// Nothing in time.
    Nothing,
}

/// Everything that waits to be written: a bounded queue of orders, and one slot of real-time data.
///
/// Orders go first. One lock for both, so that the writer sleeps on one condition.
#[derive(Debug)]
pub struct Outbox<O, T> {
    inner: Mutex<OutboxInner<O, T>>,
    changed: Condvar,
    capacity: usize,
}

#[derive(Debug)]
struct OutboxInner<O, T> {
    orders: VecDeque<O>,
    latest: Option<T>,
    closed: bool,
    /// Whether the writer is to look at the line.
    called: bool,
    superseded: u64,
}

impl<O, T> Outbox<O, T> {
    /// An empty outbox for at most `capacity` orders.
    pub fn new(capacity: usize) -> Self {
        let inner = OutboxInner {
            orders: VecDeque::with_capacity(capacity),
            latest: None,
            closed: false,
            called: false,
            superseded: 0,
        };
        Outbox {
            inner: Mutex::new(inner),
            changed: Condvar::new(),
            capacity,
        }
    }

    /// Adds an order.
    ///
    /// # Errors
    /// Gives the order back when the queue is full or closed.
    pub fn order(&self, order: O) -> Result<(), O> {
        let mut inner = lock(&self.inner);
        if inner.closed || inner.orders.len() >= self.capacity {
            return Err(order);
        }
        inner.orders.push_back(order);
        drop(inner);
        self.changed.notify_one();
        Ok(())
    }

    /// Puts real-time data in, in place of older data that were not yet written.
    pub fn put(&self, value: T) {
        let mut inner = lock(&self.inner);
        if inner.latest.replace(value).is_some() {
            inner.superseded += 1;
        }
        drop(inner);
        self.changed.notify_one();
    }

    /// Whether nothing waits, so that whoever has something may write it past the writer.
    pub fn is_idle(&self) -> bool {
        let inner = lock(&self.inner);
        inner.orders.is_empty() && inner.latest.is_none() && !inner.closed
    }

    /// Has [`next`](Self::next) return once, with nothing if need be.
    pub fn call(&self) {
        lock(&self.inner).called = true;
        self.changed.notify_one();
    }

    /// Waits for the next thing to write, at most until `until`; `None` once closed and all orders are out.
    ///
    /// Real-time data stay where they can still be replaced until `not_before`; orders do not wait.
    pub fn next(&self, not_before: Instant, until: Instant) -> Option<Outgoing<O, T>> {
        let mut inner = lock(&self.inner);
        loop {
            if let Some(order) = inner.orders.pop_front() {
                return Some(Outgoing::Order(order));
            }
            if inner.closed {
                return None;
            }
            let now = Instant::now();
            if now >= not_before
                && let Some(latest) = inner.latest.take()
            {
                return Some(Outgoing::Latest(latest));
            }
            if now >= until || std::mem::take(&mut inner.called) {
                return Some(Outgoing::Nothing);
            }
            let wake = if inner.latest.is_some() {
                until.min(not_before)
            } else {
                until
            };
            let left = wake.saturating_duration_since(now);
            inner = self
                .changed
                .wait_timeout(inner, left)
                .unwrap_or_else(PoisonError::into_inner)
                .0;
        }
    }

    /// Drops all that waits.
    pub fn clear(&self) {
        let mut inner = lock(&self.inner);
        inner.orders.clear();
        inner.latest = None;
    }

    /// Lets the writer finish: queued orders still go out, real-time data do not.
    pub fn close(&self) {
        lock(&self.inner).closed = true;
        self.changed.notify_all();
    }

    /// How many real-time values were replaced before they were written.
    pub fn superseded(&self) -> u64 {
        lock(&self.inner).superseded
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn slot_keeps_the_newest_and_counts_the_rest() {
        let slot = Slot::default();
        for i in 0..5 {
            slot.put(i, i);
        }
        assert_eq!(slot.wait_for(None, Instant::now()), Some(4));
        assert_eq!(slot.wait_for(None, Instant::now()), None);
        assert_eq!(slot.superseded(), 4);
        slot.put(5, 5);
        assert_eq!(slot.wait_for(Some(5), Instant::now()), Some(5));
        assert_eq!(
            slot.superseded(),
            4,
            "a value that was taken is not superseded"
        );
    }

    #[test]
    fn closing_wakes_the_one_who_waits() {
        let slot = Slot::<u8>::default();
        std::thread::scope(|scope| {
            let waiting =
                scope.spawn(|| slot.wait_for(Some(7), Instant::now() + Duration::from_secs(600)));
            slot.close();
            assert_eq!(waiting.join().ok(), Some(None));
        });
    }

    #[test]
    fn only_the_tick_that_is_waited_for_wakes() {
        let slot = Slot::default();
        // Around the end of the ticks' numbers.
        let wanted = 3_u32.wrapping_sub(5);
        let deadline = Instant::now() + Duration::from_secs(60);
        std::thread::scope(|scope| {
            let waiting = scope.spawn(|| slot.wait_for(Some(wanted), deadline));
            // From then on it sleeps, or holds the lock.
            while lock(&slot.inner).wanted.is_none() {
                std::thread::yield_now();
            }
            for back in (1..6).rev() {
                assert!(!slot.put(wanted.wrapping_sub(back), back));
            }
            assert!(slot.put(wanted.wrapping_add(6), 0), "one after it will do");
            assert_eq!(waiting.join().ok(), Some(Some(0)));
        });
        assert!(Instant::now() < deadline);
        assert!(slot.put(1, 7), "whoever waits next may want any");
    }

    #[test]
    fn an_earlier_tick_is_given_only_when_time_is_up() {
        let slot = Slot::default();
        slot.put(1, 8);
        let deadline = Instant::now() + Duration::from_millis(20);
        assert_eq!(slot.wait_for(Some(2), deadline), Some(8));
        assert!(Instant::now() >= deadline);
    }

    #[test]
    fn orders_go_first_and_survive_closing() {
        let outbox = Outbox::new(2);
        outbox.put("old");
        outbox.put("new");
        assert_eq!(outbox.order(1), Ok(()));
        assert_eq!(outbox.order(2), Ok(()));
        assert_eq!(outbox.order(3), Err(3), "the bound holds");
        let next = || outbox.next(Instant::now(), Instant::now());
        assert_eq!(next(), Some(Outgoing::Order(1)));
        assert_eq!(outbox.order(3), Ok(()));
        assert_eq!(next(), Some(Outgoing::Order(2)));
        outbox.close();
        assert_eq!(outbox.order(4), Err(4));
        assert_eq!(next(), Some(Outgoing::Order(3)));
        assert_eq!(next(), None, "no force goes out behind the last order");
        assert_eq!(outbox.superseded(), 1);
    }

    #[test]
    fn what_may_still_be_replaced_waits_and_what_is_cleared_is_gone() {
        let outbox = Outbox::<u8, u8>::new(2);
        let (now, later) = (Instant::now(), Instant::now() + Duration::from_secs(600));
        outbox.put(1);
        assert_eq!(outbox.next(later, now), Some(Outgoing::Nothing));
        assert_eq!(outbox.next(now, later), Some(Outgoing::Latest(1)));
        outbox.put(2);
        assert_eq!(outbox.order(3), Ok(()));
        outbox.clear();
        assert_eq!(outbox.next(now, now), Some(Outgoing::Nothing));
    }

    #[test]
    fn the_writer_is_called_once_and_nothing_goes_past_what_waits() {
        let outbox = Outbox::<u8, u8>::new(2);
        let later = Instant::now() + Duration::from_secs(600);
        assert!(outbox.is_idle());
        outbox.call();
        assert_eq!(outbox.next(later, later), Some(Outgoing::Nothing));
        outbox.call();
        outbox.put(1);
        assert!(!outbox.is_idle());
        assert_eq!(
            outbox.next(Instant::now(), later),
            Some(Outgoing::Latest(1))
        );
        assert_eq!(outbox.next(later, later), Some(Outgoing::Nothing));
        assert_eq!(outbox.order(2), Ok(()));
        assert!(!outbox.is_idle());
        outbox.clear();
        assert!(outbox.is_idle());
        outbox.close();
        assert!(!outbox.is_idle(), "no force goes out behind the last order");
    }
}
