//! A first-in-first-out queue of elements in which each waits at most once.
//!
//! Entry point: [`Queue`]. It never allocates after [`Queue::new`].

use crate::in_place::clone_in_place;

/// Elements that wait, first moved first.
#[derive(Debug)]
pub(super) struct Queue {
    ring: Vec<u32>,
    mask: usize,
    head: usize,
    length: usize,
    waiting: Vec<bool>,
}

clone_in_place!(Queue {
    ring,
    mask,
    head,
    length,
    waiting,
});

impl Queue {
    /// An empty queue for `nodes` elements.
    pub fn new(nodes: usize) -> Self {
        let size = nodes.next_power_of_two();
        Self {
            ring: vec![0; size],
            mask: size - 1,
            head: 0,
            length: 0,
            waiting: vec![false; nodes],
        }
    }

    /// Appends an element that does not wait already.
    #[inline]
    pub fn push(&mut self, node: u32) {
        if !self.waiting[node as usize] {
            self.waiting[node as usize] = true;
            self.ring[(self.head + self.length) & self.mask] = node;
            self.length += 1;
        }
    }

    /// The element that has waited longest.
    #[inline]
    pub fn pop(&mut self) -> Option<u32> {
        if self.length == 0 {
            return None;
        }
        let node = self.ring[self.head];
        self.head = (self.head + 1) & self.mask;
        self.length -= 1;
        self.waiting[node as usize] = false;
        Some(node)
    }

    /// Forgets who waits.
    pub fn clear(&mut self) {
        while self.pop().is_some() {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_in_first_out_and_each_once() {
        let mut queue = Queue::new(3);
        for round in 0..5 {
            let order = [(round) % 3, (round + 2) % 3, (round + 1) % 3];
            for node in order {
                queue.push(node);
                queue.push(node);
            }
            for node in order {
                assert_eq!(queue.pop(), Some(node));
            }
            assert_eq!(queue.pop(), None);
        }
        queue.push(1);
        queue.clear();
        assert_eq!(queue.pop(), None);
        queue.push(1);
        assert_eq!(queue.pop(), Some(1));
    }
}
