//! What of a thread's path is slack, between which points, and how long it is.
//!
//! Entry point: [`stretches`].

use super::model::{ThreadPlace, ThreadPoint};
use super::segments::NO_TENSION_N;
use super::skin::Skin;
use nalgebra::Vector3;

/// A stretch with less slack than this, of its length, is straight.
const STRAIGHT: f64 = 1e-6;
/// The direction of a thread where it comes out of tissue is that of the last so much of its way inside \[m\].
const WITHIN_M: f64 = 1.5e-3;

/// A point that holds an end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Held {
    /// Where it is \[m\].
    pub at: Vector3<f64>,
    /// Unit direction of the thread there, from tail to head, where tissue or needle gives it one.
    pub way: Option<Vector3<f64>>,
}

/// Where a stretch begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Begin {
    Face,
    Hand,
    /// It is the loose tail of the thread, or of what a cut has left.
    Loose,
}

/// What lies slack outside the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    /// The face that it begins at or behind, 0 for none, and at what.
    pub key: (u32, Begin),
    /// What holds it at the side of the tail and of the head.
    pub ends: [Option<Held>; 2],
    /// What there is of thread for it \[m\], above zero.
    pub length_m: f64,
    /// Where it begins along the thread, counted from the head \[m\].
    pub along_m: f64,
    /// Points of the path up to where it begins, that one among them, and up to its end, without it.
    pub first: usize,
    pub next: usize,
}

impl Stretch {
    /// Whether its ends have a direction.
    pub fn directed(&self) -> [bool; 2] {
        self.ends
            .map(|end| end.is_some_and(|end| end.way.is_some()))
    }

    /// Away from what it comes out of and goes into.
    pub fn out(&self) -> Vector3<f64> {
        let [from, to] = self
            .ends
            .map(|end| end.and_then(|end| end.way).unwrap_or_else(Vector3::zeros));
        from - to
    }

    /// Unit vector along which a loose end can be laid straight without meeting the tissue: `down`, as it comes out of what holds it,
    /// between the two or to their sides, or up; as it comes out, if there is no such way.
    pub fn clear_way(
        &self,
        down: &Vector3<f64>,
        (skin, at): (&Skin, &[Vector3<f64>]),
    ) -> Vector3<f64> {
        let unit = |way: Vector3<f64>| way.try_normalize(0.0);
        let (out, down) = (unit(self.out()), unit(*down));
        let first = out.or(down).unwrap_or_else(Vector3::x);
        let down = down.unwrap_or_else(Vector3::zeros);
        let aside = unit(first.cross(&down)).unwrap_or_else(Vector3::zeros);
        let ([None, Some(held)] | [Some(held), None]) = self.ends else {
            return first;
        };
        // Its own end may lie on the tissue.
        let from = held.at + first * WITHIN_M;
        let is_clear = |way: &Vector3<f64>| !skin.is_cut(at, &from, &(from + way * self.length_m));
        let ways = [
            down,
            first + down,
            down + aside,
            down - aside,
            first,
            first + aside,
            first - aside,
            aside,
            -aside,
            first - down,
            -down,
        ];
        let mut ways = ways.into_iter().filter_map(unit);
        ways.find(is_clear).unwrap_or(first)
    }
}

/// The slack stretches of a path, each point with the face that it is or lies behind, in its order. Along the thread the tail ends at `end_m`
/// \[m\], and the needle holds the head along `tangent`.
pub(super) fn stretches(
    places: &[(u32, ThreadPoint)],
    end_m: f64,
    tangent: &Vector3<f64>,
) -> Vec<Stretch> {
    let mut found = Vec::new();
    let last = places.len().saturating_sub(1);
    let held = |place: usize, from: bool| {
        let point = &places[place].1;
        let way = match point.what {
            ThreadPlace::End if place == last => Some(*tangent),
            ThreadPlace::End => None,
            _ => within(places, place, from),
        };
        let at = Vector3::from(point.at_m);
        Held { at, way }
    };
    let Some((_, tail)) = places.first() else {
        return found;
    };
    let is_outside = matches!(tail.what, ThreadPlace::End | ThreadPlace::Enters);
    if is_outside && tail.along_m > end_m {
        found.push(Stretch {
            key: (0, Begin::Loose),
            ends: [None, Some(held(0, false))],
            length_m: tail.along_m - end_m,
            along_m: end_m,
            first: 0,
            next: 0,
        });
    }
    let mut first = 0;
    while first < last {
        let (key, from) = &places[first];
        let wraps = places[first + 1..].iter();
        let wraps = wraps.take_while(|(_, point)| point.what == ThreadPlace::Wraps);
        let next = first + 1 + wraps.count();
        let ends = places.get(next).map(|(_, to)| (from.what, to.what, to));
        let length_m = ends.map_or(0.0, |(.., to)| to.along_m - from.along_m);
        let loose = [from.what, ends.map_or(ThreadPlace::Inside, |(_, to, _)| to)];
        let loose = loose.map(|what| what == ThreadPlace::Cut);
        let is_outside = matches!(
            ends,
            Some((
                ThreadPlace::End | ThreadPlace::Leaves | ThreadPlace::Cut,
                ThreadPlace::End | ThreadPlace::Enters | ThreadPlace::Cut,
                _
            ))
        ) && loose != [true; 2];
        let begin = match from.what {
            ThreadPlace::End => Begin::Hand,
            ThreadPlace::Cut => Begin::Loose,
            _ => Begin::Face,
        };
        let way_m = places.get(first..=next).map_or(0.0, way_m);
        if is_outside
            && from.tension_n <= NO_TENSION_N
            && length_m - way_m > STRAIGHT * length_m.max(way_m)
        {
            found.push(Stretch {
                key: (*key, begin),
                ends: [
                    (!loose[0]).then(|| held(first, true)),
                    (!loose[1]).then(|| held(next, false)),
                ],
                length_m,
                along_m: from.along_m,
                first: first + 1,
                next,
            });
        }
        first = next;
    }
    found
}

/// Length of a part of a path \[m\].
fn way_m(places: &[(u32, ThreadPoint)]) -> f64 {
    let pairs = places.windows(2);
    pairs
        .map(|two| {
            let [a, b] = [two[0], two[1]].map(|(_, point)| Vector3::from(point.at_m));
            a.metric_distance(&b)
        })
        .sum()
}

/// Direction from tail to head of the way inside tissue next to a point of the boundary: before it, where a stretch begins `from` it.
fn within(places: &[(u32, ThreadPoint)], place: usize, from: bool) -> Option<Vector3<f64>> {
    let at = |place: usize| Some(Vector3::from(places.get(place)?.1.at_m));
    let edge = at(place)?;
    let (mut last, mut left_m, mut here) = (edge, WITHIN_M, place);
    loop {
        let next = if from {
            here.checked_sub(1)
        } else {
            Some(here + 1)
        };
        let Some((next, point)) = next.and_then(|next| Some((next, at(next)?))) else {
            break;
        };
        here = next;
        let (far, piece_m) = (point - last, point.metric_distance(&last));
        if piece_m >= left_m {
            last += far * (left_m / piece_m);
            break;
        }
        (last, left_m) = (point, left_m - piece_m);
        // A passage ends at the boundary.
        if places.get(here)?.1.what != ThreadPlace::Inside {
            break;
        }
    }
    let way = if from { edge - last } else { last - edge };
    way.try_normalize(1e-3 * WITHIN_M)
}
