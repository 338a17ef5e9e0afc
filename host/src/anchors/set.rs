//! The constraints of one solve: what every source appends to.

use super::{AnchorPoint, AnchorSettings, MultiPointConstraint, PointConstraint, Term};

/// Points of tissue, and the rows on them.
#[derive(Clone, Debug, Default)]
pub(crate) struct ConstraintSet {
    /// Points that rows act on; they come before the ways.
    pub anchors: Vec<AnchorPoint>,
    /// From one point to another, whose displacement is that of the second less that of the first.
    pub ways: Vec<[Option<AnchorPoint>; 2]>,
    /// Rows on one anchor or way each, in the order of these.
    pub rows: Vec<PointConstraint>,
    /// Rows on several.
    pub spread: Vec<MultiPointConstraint>,
    pub terms: Vec<Term>,
    /// Rows that give way by themselves, and by how much \[m/N\].
    pub soft: Vec<(u32, f64)>,
}

impl ConstraintSet {
    /// Empty, with room for what `settings` allow.
    pub fn new(settings: &AnchorSettings) -> Self {
        let (rows, anchors) = (settings.most_rows, settings.most_anchors);
        Self {
            anchors: Vec::with_capacity(anchors),
            ways: Vec::with_capacity(anchors),
            rows: Vec::with_capacity(rows),
            spread: Vec::with_capacity(settings.most_spread),
            terms: Vec::with_capacity(settings.most_terms),
            soft: Vec::with_capacity(rows),
        }
    }

    pub fn clear(&mut self) {
        self.anchors.clear();
        self.ways.clear();
        self.rows.clear();
        self.spread.clear();
        self.terms.clear();
        self.soft.clear();
    }

    /// Rows, those on several anchors included.
    pub fn count(&self) -> usize {
        self.rows.len() + self.spread.len()
    }

    /// Adds a point; its number, which its rows name.
    pub fn add(&mut self, anchor: AnchorPoint) -> u32 {
        debug_assert!(self.ways.is_empty(), "points come before ways");
        self.anchors.push(anchor);
        self.anchors.len() as u32 - 1
    }

    /// Adds a way between two points; its number, which its rows name.
    pub fn add_way(&mut self, ends: [Option<AnchorPoint>; 2]) -> u32 {
        self.ways.push(ends);
        (self.anchors.len() + self.ways.len()) as u32 - 1
    }
}
