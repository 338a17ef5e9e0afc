//! Contact rows: the local contact problem, solved anew at the pose of every tick.
//!
//! Entry point: [`ContactRows`].

/// The rows of one tool, unpacked; none is the default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactRows {
    /// How many there are.
    count: u8,
}

impl ContactRows {
    /// No rows.
    pub const NONE: ContactRows = ContactRows { count: 0 };

    /// Goes on from other rows.
    pub fn adopt(&mut self, _old: &ContactRows, _dx: &[f32; 6], _solved_us: u64) {}

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}
