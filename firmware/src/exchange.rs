//! Latest-value slot between two tasks: three buffers, handed over by swapping references.
//!
//! Entry point: [`Exchange`]. The writer fills its own buffer and swaps it with the middle one; the reader
//! swaps the middle one with its own. Only the swap needs the lock, whatever the size of a value.

/// The middle buffer. The two outer ones belong to the writer and to the reader.
pub struct Exchange<'a, T> {
    middle: &'a mut T,
    fresh: bool,
}

impl<'a, T> Exchange<'a, T> {
    /// An exchange that holds nothing yet.
    pub fn new(middle: &'a mut T) -> Self {
        Self {
            middle,
            fresh: false,
        }
    }

    /// Hands the writer's buffer over and gives an older one back to write into.
    ///
    /// Returns whether this replaced a value that the reader never took.
    pub fn publish(&mut self, back: &mut &'a mut T) -> bool {
        core::mem::swap(&mut self.middle, back);
        core::mem::replace(&mut self.fresh, true)
    }

    /// Swaps the newest value into `front`; false, and `front` untouched, if it has been taken already.
    pub fn take(&mut self, front: &mut &'a mut T) -> bool {
        if self.fresh {
            core::mem::swap(&mut self.middle, front);
        }
        core::mem::replace(&mut self.fresh, false)
    }
}

#[cfg(test)]
mod tests {
    use super::Exchange;

    /// Reference: a plain `Option` that is overwritten and taken.
    #[test]
    fn every_interleaving_reads_the_newest_value_once() {
        // Every sequence of 12 operations, a set bit is a publish and a clear one a take.
        for order in 0_u32..1 << 12 {
            let (mut a, mut b, mut c) = (0, 0, 0);
            let (mut back, mut front) = (&mut a, &mut b);
            let mut exchange = Exchange::new(&mut c);
            let mut expected = None;
            for step in 0..12 {
                if order >> step & 1 == 1 {
                    *back = step + 1;
                    let replaced = exchange.publish(&mut back);
                    assert_eq!(replaced, expected.replace(step + 1).is_some());
                } else {
                    let before = *front;
                    let fresh = exchange.take(&mut front);
                    assert_eq!(fresh.then_some(*front), expected.take());
                    assert!(fresh || *front == before);
                }
            }
        }
    }

    #[test]
    fn the_reader_keeps_its_value_while_the_writer_works() {
        let (mut a, mut b, mut c) = ([0; 40], [0; 40], [0; 40]);
        let (mut back, mut front) = (&mut a, &mut b);
        let mut exchange = Exchange::new(&mut c);
        back.fill(1);
        exchange.publish(&mut back);
        assert!(exchange.take(&mut front));
        for value in 2..5 {
            back.fill(value);
            exchange.publish(&mut back);
            back.fill(99);
            assert_eq!(front, &[1; 40]);
        }
        assert!(exchange.take(&mut front));
        assert_eq!(front, &[4; 40]);
    }
}
