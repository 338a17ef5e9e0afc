//! Boxes around things that move, in boxes around boxes: which of them may come near which.
//!
//! Entry points: [`Tree::new`], [`Tree::refit`], [`Tree::near`], [`Tree::along`], [`Tree::where_near`],
//! [`Tree::least`], [`Tree::pairs`], [`Tree::own_pairs`], [`Tree::groups`]. The tree stays as it was built, by halving at the median, and its boxes follow. Our own: of the crates bvh and rstar
//! know no pairs and no refit, and parry3d-f64 brings a second linear algebra and 40 crates for what is here.

use nalgebra::Vector3;

/// Things in a leaf.
const LEAF: usize = 4;
/// A binary tree halved at the median of 2^32 things at most is no deeper.
const DEPTH: usize = 32;
/// Pairs yet to be looked at: two of each depth while the two are one, then one of each depth of either.
const WAITING: usize = 4 * DEPTH + 4;
/// What a line passes a box by within this part of both is for rounding to say.
const ROUNDING: f64 = 1e-12;

/// An axis-aligned box. It is made of coordinates as they are, so that nothing in it is lost by rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Least coordinates \[m\], (3).
    pub low: Vector3<f64>,
    /// Greatest coordinates \[m\], (3).
    pub high: Vector3<f64>,
}

impl Bounds {
    /// Around nothing.
    pub const NOTHING: Self = Self {
        low: Vector3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        high: Vector3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    /// Around a point, too. What is no number may be anywhere.
    #[inline]
    pub fn with(mut self, point: &Vector3<f64>) -> Self {
        for axis in 0..3 {
            let x = point[axis];
            let (low, high) = if x.is_nan() {
                (f64::NEG_INFINITY, f64::INFINITY)
            } else {
                (x, x)
            };
            self.low[axis] = self.low[axis].min(low);
            self.high[axis] = self.high[axis].max(high);
        }
        self
    }

    /// Around another box, too.
    #[inline]
    pub fn and(&self, other: &Self) -> Self {
        Self {
            low: self.low.inf(&other.low),
            high: self.high.sup(&other.high),
        }
    }

    /// Larger by so much on every side \[m\], at least 0.
    #[inline]
    pub fn grown(&self, by: f64) -> Self {
        Self {
            low: self.low.map(|x| (x - by).next_down()),
            high: self.high.map(|x| (x + by).next_up()),
        }
    }

    /// Whether two boxes have a point in common; one around nothing has none.
    #[inline]
    pub fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.low[axis] <= other.high[axis] && other.low[axis] <= self.high[axis])
    }

    /// Its middle \[m\], (3).
    #[inline]
    pub fn middle(&self) -> Vector3<f64> {
        (self.low + self.high) * 0.5
    }

    /// Square of the distance to a point \[m^2\]: not more than what is computed, in the same way, for any point of the
    /// box, as rounding keeps the order of numbers.
    #[inline]
    pub fn distance_squared(&self, point: &Vector3<f64>) -> f64 {
        let (above, below) = (self.low - point, point - self.high);
        above.sup(&below).map(|x| x.max(0.0)).norm_squared()
    }

    /// Square of the distance to another box.
    fn apart_squared(&self, other: &Self) -> f64 {
        let (above, below) = (self.low - other.high, other.low - self.high);
        above.sup(&below).map(|x| x.max(0.0)).norm_squared()
    }

    /// Whether a straight line has a point in the box or in one larger by rounding (separating axes: those of
    /// the box and their cross products with the line).
    #[inline]
    pub fn cut_by(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let half = (self.high - self.low) * 0.5;
        let way = (to - from) * 0.5;
        let apart = (from + to - self.low - self.high) * 0.5;
        let reach = way.abs();
        let slack = ROUNDING * (half.amax() + reach.amax());
        (0..3).all(|axis| {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            let across = apart[next] * way[last] - apart[last] * way[next];
            let most = half[next] * reach[last] + half[last] * reach[next];
            // Written so that what is no number is not found apart.
            let apart = apart[axis].abs() > half[axis] + reach[axis] + slack
                || across.abs() > most + slack * reach.amax();
            !apart
        })
    }

    fn size(&self) -> f64 {
        (self.high - self.low).sum()
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Bounds,
    /// Of a leaf the place of its first thing, else its first child; the second follows.
    first: u32,
    /// Things of a leaf; else 0.
    things: u32,
}

/// A tree of boxes over things that are counted from 0.
#[derive(Clone, Debug)]
pub struct Tree {
    /// Children after their parents, the root first.
    nodes: Vec<Node>,
    /// Things by place.
    things: Vec<u32>,
    /// Their boxes, by place.
    boxes: Vec<Bounds>,
}

impl Tree {
    /// Over `count` things, whose boxes `bounds` gives.
    pub fn new(count: u32, bounds: impl Fn(u32) -> Bounds) -> Self {
        let mut things: Vec<(Vector3<f64>, u32)> = (0..count)
            .map(|thing| {
                let Bounds { low, high } = bounds(thing);
                (low + high, thing)
            })
            .collect();
        let leaf = |first: usize, things: usize| Node {
            bounds: Bounds::NOTHING,
            first: first as u32,
            things: things as u32,
        };
        let mut nodes = vec![leaf(0, things.len())];
        let mut place = 0;
        while let Some(&node) = nodes.get(place) {
            let (first, count) = (node.first as usize, node.things as usize);
            if count > LEAF {
                let part = &mut things[first..first + count];
                let around = part
                    .iter()
                    .fold(Bounds::NOTHING, |all, (middle, _)| all.with(middle));
                let axis = (around.high - around.low).imax();
                let half = count / 2;
                part.select_nth_unstable_by(half, |a, b| {
                    a.0[axis].total_cmp(&b.0[axis]).then(a.1.cmp(&b.1))
                });
                nodes[place] = leaf(nodes.len(), 0);
                nodes.push(leaf(first, half));
                nodes.push(leaf(first + half, count - half));
            }
            place += 1;
        }
        let mut tree = Self {
            nodes,
            boxes: vec![Bounds::NOTHING; things.len()],
            things: things.into_iter().map(|(_, thing)| thing).collect(),
        };
        tree.refit(bounds);
        tree
    }

    /// Puts the boxes around where the things are now. Allocates nothing.
    pub fn refit(&mut self, bounds: impl Fn(u32) -> Bounds) {
        for (around, thing) in self.boxes.iter_mut().zip(&self.things) {
            *around = bounds(*thing);
        }
        for place in (0..self.nodes.len()).rev() {
            let node = self.nodes[place];
            let first = node.first as usize;
            self.nodes[place].bounds = if node.things > 0 || self.boxes.is_empty() {
                self.boxes[first..first + node.things as usize]
                    .iter()
                    .fold(Bounds::NOTHING, |all, around| all.and(around))
            } else {
                self.nodes[first].bounds.and(&self.nodes[first + 1].bounds)
            };
        }
    }

    /// Around everything.
    pub fn bounds(&self) -> Bounds {
        self.nodes[0].bounds
    }

    /// Visits all things whose boxes meet `bounds`. Allocates nothing.
    pub fn near(&self, bounds: &Bounds, visit: impl FnMut(u32)) {
        self.where_near(|_, around| around.meets(bounds), visit);
    }

    /// Visits all things whose boxes a straight line may meet. Allocates nothing.
    pub fn along(&self, from: &Vector3<f64>, to: &Vector3<f64>, visit: impl FnMut(u32)) {
        self.where_near(|_, around| around.cut_by(from, to), visit);
    }

    /// Visits all things whose boxes, and those around them, `wanted` takes; it is given the number of the node that a box is in.
    /// Allocates nothing.
    pub fn where_near(
        &self,
        mut wanted: impl FnMut(u32, &Bounds) -> bool,
        mut visit: impl FnMut(u32),
    ) {
        let mut waiting = [0; DEPTH + 2];
        // The root over nothing has no children.
        let mut count = usize::from(!self.things.is_empty());
        while count > 0 {
            count -= 1;
            let number = waiting[count];
            let node = &self.nodes[number as usize];
            if !wanted(number, &node.bounds) {
                continue;
            }
            if node.things == 0 {
                (waiting[count], waiting[count + 1]) = (node.first + 1, node.first);
                count += 2;
                continue;
            }
            for (thing, around) in self.of_leaf(node) {
                if wanted(number, &around) {
                    visit(thing);
                }
            }
        }
    }

    /// The least that `value` says of a thing; infinity if there are none. `bound` says of a box what no value of a thing
    /// in it is below: things in boxes where that is above the least so far are not asked. Allocates nothing.
    pub fn least(&self, bound: impl Fn(&Bounds) -> f64, mut value: impl FnMut(u32) -> f64) -> f64 {
        let mut least = f64::INFINITY;
        let mut waiting = [(0, f64::NEG_INFINITY); DEPTH + 2];
        let mut count = usize::from(!self.things.is_empty());
        while count > 0 {
            count -= 1;
            let (number, from) = waiting[count];
            if from > least {
                continue;
            }
            let node = &self.nodes[number as usize];
            if node.things == 0 {
                let child = |number: u32| (number, bound(&self.nodes[number as usize].bounds));
                let (one, other) = (child(node.first), child(node.first + 1));
                // The nearer one is to be looked at first: it comes last.
                (waiting[count], waiting[count + 1]) = if other.1 < one.1 {
                    (one, other)
                } else {
                    (other, one)
                };
                count += 2;
                continue;
            }
            for (thing, around) in self.of_leaf(node) {
                if bound(&around) <= least {
                    least = least.min(value(thing));
                }
            }
        }
        least
    }

    /// The group of each node by its number, none above them, and the groups' things: all that is below one node at that
    /// depth, or a leaf above it.
    pub fn groups(&self, depth: u32) -> (Vec<Option<u32>>, Vec<Vec<u32>>) {
        let mut by_node = vec![None; self.nodes.len()];
        let mut depths = vec![0; self.nodes.len()];
        let mut things: Vec<Vec<u32>> = Vec::new();
        for (place, node) in self.nodes.iter().enumerate() {
            if by_node[place].is_none() && (depths[place] == depth || node.things > 0) {
                by_node[place] = Some(things.len() as u32);
                things.push(Vec::new());
            }
            if node.things > 0 {
                if let Some(own) = by_node[place].and_then(|group| things.get_mut(group as usize)) {
                    own.extend(self.of_leaf(node).map(|(thing, _)| thing));
                }
            } else if !self.things.is_empty() {
                for child in [node.first, node.first + 1] {
                    by_node[child as usize] = by_node[place];
                    depths[child as usize] = depths[place] + 1;
                }
            }
        }
        (by_node, things)
    }

    /// Visits all pairs of a thing here and one there whose boxes meet, each once, in an order that depends on
    /// the trees alone. Allocates nothing.
    pub fn pairs(&self, other: &Self, visit: impl FnMut(u32, u32)) {
        let mut waiting = Waiting::new();
        waiting.push(0, 0);
        self.follow(other, false, &mut waiting, visit);
    }

    /// The least distance between the box of a thing here and that of one there; infinity if there are none.
    /// Allocates nothing.
    pub fn apart(&self, other: &Self) -> f64 {
        if self.things.is_empty() || other.things.is_empty() {
            return f64::INFINITY;
        }
        let mut least = f64::INFINITY;
        let mut waiting = Waiting::new();
        waiting.push(0, 0);
        while let Some((here, there)) = waiting.pop() {
            let (a, b) = (&self.nodes[here as usize], &other.nodes[there as usize]);
            if a.bounds.apart_squared(&b.bounds) >= least {
                continue;
            }
            // The nearer child is to be looked at first: it comes last.
            match (a.things, b.things) {
                (0, _) if b.things > 0 || a.bounds.size() > b.bounds.size() => {
                    let [near, far] = self.by_distance(a.first, &b.bounds);
                    waiting.push(far, there);
                    waiting.push(near, there);
                }
                (_, 0) => {
                    let [near, far] = other.by_distance(b.first, &a.bounds);
                    waiting.push(here, far);
                    waiting.push(here, near);
                }
                _ => {
                    for (_, around) in self.of_leaf(a) {
                        for (_, bounds) in other.of_leaf(b) {
                            least = least.min(around.apart_squared(&bounds));
                        }
                    }
                }
            }
        }
        // One unit for each operation, down.
        least.sqrt() * (1.0 - 8.0 * f64::EPSILON)
    }

    /// A node's children, the one that is nearer to a box first.
    fn by_distance(&self, first: u32, to: &Bounds) -> [u32; 2] {
        let apart = |node: u32| self.nodes[node as usize].bounds.apart_squared(to);
        if apart(first + 1) < apart(first) {
            [first + 1, first]
        } else {
            [first, first + 1]
        }
    }

    /// Visits all pairs of two things here whose boxes meet, each once. Allocates nothing.
    pub fn own_pairs(&self, visit: impl FnMut(u32, u32)) {
        let mut waiting = Waiting::new();
        waiting.push(0, 0);
        self.follow(self, true, &mut waiting, visit);
    }

    fn follow(
        &self,
        other: &Self,
        own: bool,
        waiting: &mut Waiting,
        mut visit: impl FnMut(u32, u32),
    ) {
        if self.things.is_empty() || other.things.is_empty() {
            return;
        }
        while let Some((here, there)) = waiting.pop() {
            let (a, b) = (&self.nodes[here as usize], &other.nodes[there as usize]);
            if !a.bounds.meets(&b.bounds) {
                continue;
            }
            match (a.things, b.things) {
                (0, _) if own && here == there => {
                    waiting.push(a.first, a.first + 1);
                    waiting.push(a.first + 1, a.first + 1);
                    waiting.push(a.first, a.first);
                }
                (0, _) if b.things > 0 || a.bounds.size() > b.bounds.size() => {
                    waiting.push(a.first + 1, there);
                    waiting.push(a.first, there);
                }
                (_, 0) => {
                    waiting.push(here, b.first + 1);
                    waiting.push(here, b.first);
                }
                _ => {
                    for (number, (thing, around)) in self.of_leaf(a).enumerate() {
                        let skipped = if own && here == there { number + 1 } else { 0 };
                        for (against, bounds) in other.of_leaf(b).skip(skipped) {
                            if around.meets(&bounds) {
                                visit(thing, against);
                            }
                        }
                    }
                }
            }
        }
    }

    fn of_leaf(&self, node: &Node) -> impl Iterator<Item = (u32, Bounds)> {
        let places = node.first as usize..(node.first + node.things) as usize;
        let things = self.things[places.clone()].iter().copied();
        things.zip(self.boxes[places].iter().copied())
    }
}

/// Pairs of nodes yet to be looked at.
struct Waiting {
    pairs: [(u32, u32); WAITING],
    count: usize,
}

impl Waiting {
    fn new() -> Self {
        Self {
            pairs: [(0, 0); WAITING],
            count: 0,
        }
    }

    fn push(&mut self, here: u32, there: u32) {
        self.pairs[self.count] = (here, there);
        self.count += 1;
    }

    fn pop(&mut self) -> Option<(u32, u32)> {
        self.count = self.count.checked_sub(1)?;
        Some(self.pairs[self.count])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(count: u32, spread: f64) -> Vec<Vector3<f64>> {
        let mut x = 3u64;
        let mut next = || {
            x = x
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (x >> 40) as f64 / (1u64 << 24) as f64 * spread
        };
        (0..count)
            .map(|_| Vector3::from_fn(|_, _| next()))
            .collect()
    }

    fn around(at: &[Vector3<f64>], size: f64) -> impl Fn(u32) -> Bounds {
        move |thing| Bounds::NOTHING.with(&at[thing as usize]).grown(size)
    }

    fn sorted(mut pairs: Vec<(u32, u32)>) -> Vec<(u32, u32)> {
        pairs.sort_unstable();
        pairs
    }

    /// Against all pairs, for trees of no, one and many things, built there and refitted from elsewhere.
    #[test]
    fn pairs_are_those_whose_boxes_meet_each_once() {
        for (count, others) in [(0, 5), (1, 1), (3, 40), (200, 130)] {
            let (a, b) = (points(count, 1.0), points(others, 0.8));
            let before = points(count, 7.0);
            let mut moved = Tree::new(count, around(&before, 0.01));
            moved.refit(around(&a, 0.06));
            let other = Tree::new(others, around(&b, 0.06));
            for tree in [Tree::new(count, around(&a, 0.06)), moved] {
                let meet = |x: &Vector3<f64>, y: &Vector3<f64>| (x - y).amax() <= 0.12;
                let mut found = Vec::new();
                tree.pairs(&other, |x, y| found.push((x, y)));
                let mut expected = Vec::new();
                for x in 0..count {
                    for y in 0..others {
                        if meet(&a[x as usize], &b[y as usize]) {
                            expected.push((x, y));
                        }
                    }
                }
                assert_eq!(sorted(found), expected);

                let mut found = Vec::new();
                tree.own_pairs(|x, y| found.push((x.min(y), x.max(y))));
                let mut expected = Vec::new();
                for x in 0..count {
                    for y in x + 1..count {
                        if meet(&a[x as usize], &a[y as usize]) {
                            expected.push((x, y));
                        }
                    }
                }
                assert_eq!(sorted(found), expected);
                assert!(count < 200 || expected.len() > 100);

                let mut near = Vec::new();
                let here = Bounds::NOTHING.with(&Vector3::repeat(0.4)).grown(0.1);
                tree.near(&here, |x| near.push((x, 0)));
                let close = |x: &u32| meet_at(&a[*x as usize], 0.16);
                let expected: Vec<_> = (0..count).filter(close).map(|x| (x, 0)).collect();
                assert_eq!(sorted(near), expected);
            }
        }
    }

    #[test]
    fn what_is_nearest_to_a_point_is_found() {
        for count in [0, 1, 4, 5, 300] {
            let at = points(count, 1.0);
            let tree = Tree::new(count, around(&at, 0.0));
            let mut asked = 0;
            for from in points(100, 1.5) {
                let square = |x: u32| (at[x as usize] - from).norm_squared();
                let expected = (0..count).map(square).fold(f64::INFINITY, f64::min);
                let found = tree.least(
                    |bounds| bounds.distance_squared(&from),
                    |x| {
                        asked += 1;
                        square(x)
                    },
                );
                assert_eq!(found, expected);
            }
            assert!(count < 300 || asked < 100 * count / 10, "{asked}");
        }
    }

    fn meet_at(x: &Vector3<f64>, size: f64) -> bool {
        (x - Vector3::repeat(0.4)).amax() <= size
    }

    /// A line that passes a box by is told from one that cuts it, to a part in a million; against places along it.
    #[test]
    fn along_a_line_are_the_boxes_that_it_cuts() {
        let at = points(300, 1.0);
        let tree = Tree::new(300, around(&at, 0.07));
        let mut cuts = 0;
        for ends in points(200, 1.4).chunks_exact(2) {
            let (from, to) = (ends[0], ends[1]);
            let mut found = Vec::new();
            tree.along(&from, &to, |thing| found.push((thing, 0)));
            let found = sorted(found);
            for (thing, middle) in at.iter().enumerate() {
                // Largest distance along an axis: convex along the line.
                let far = |s: f64| (from.lerp(&to, s) - middle).amax();
                let (mut low, mut high) = (0.0, 1.0);
                for _ in 0..100 {
                    let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
                    if far(a) < far(b) {
                        high = b;
                    } else {
                        low = a;
                    }
                }
                let least = far(0.5 * (low + high));
                let is_found = found.binary_search(&(thing as u32, 0)).is_ok();
                assert!(is_found || least > 0.07 * (1.0 - 1e-6), "missed at {least}");
                assert!(!is_found || least < 0.07 * (1.0 + 1e-6), "found at {least}");
                cuts += u32::from(is_found);
            }
        }
        assert!(cuts > 100, "{cuts}");
    }

    /// A thousand things in one place: the tree halves them all the same, and its stack does.
    #[test]
    fn things_in_one_place_all_meet() {
        let at = vec![Vector3::zeros(); 1000];
        let tree = Tree::new(1000, around(&at, 0.0));
        let mut pairs = 0;
        tree.own_pairs(|_, _| pairs += 1);
        assert_eq!(pairs, 1000 * 999 / 2);
        tree.pairs(&tree, |_, _| pairs -= 1);
        assert_eq!(pairs, 1000 * 999 / 2 - 1000 * 1000);
    }

    #[test]
    fn what_is_no_number_may_be_anywhere() {
        let mut at = points(50, 1.0);
        at[7].y = f64::NAN;
        let tree = Tree::new(50, around(&at, 0.01));
        let mut found = Vec::new();
        let column = Bounds::NOTHING
            .with(&Vector3::new(at[7].x, 1e9, at[7].z))
            .grown(0.1);
        tree.near(&column, |thing| found.push(thing));
        assert_eq!(found, [7]);
        // But nothing is nowhere.
        let nothing = Tree::new(0, around(&[], 0.01));
        let lost = Tree::new(1, around(&[Vector3::repeat(f64::NAN)], 0.01));
        nothing.pairs(&lost, |_, _| panic!("of nothing"));
        nothing.near(&lost.bounds(), |_| panic!("near nothing"));
    }
}
