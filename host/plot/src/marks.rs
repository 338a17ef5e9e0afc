//! How series are told apart: by colour, by the shape of their marks, and by dashes, any of which is enough.

use plotters::style::RGBColor;

/// What the marks of a series look like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    pub colour: RGBColor,
    pub shape: Shape,
    pub filled: bool,
    /// Lengths of a dash and of the gap after it \[px\]; solid without.
    pub dash: Option<(f64, f64)>,
}

/// Outline of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    Circle,
    Square,
    Up,
    Diamond,
    Down,
    Cross,
    Plus,
}

/// Told apart by colour-blind eyes as well (Okabe and Ito 2008), but for their yellow, which is too light on white, and
/// black, which is a bound's.
const COLOURS: [RGBColor; 8] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0x5e, 0x3c, 0x99),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x70, 0x70, 0x70),
];
const SHAPES: [(Shape, bool); 12] = [
    (Shape::Circle, true),
    (Shape::Square, false),
    (Shape::Up, true),
    (Shape::Diamond, false),
    (Shape::Cross, true),
    (Shape::Down, true),
    (Shape::Circle, false),
    (Shape::Square, true),
    (Shape::Up, false),
    (Shape::Plus, true),
    (Shape::Diamond, true),
    (Shape::Down, false),
];
const DASHES: [Option<(f64, f64)>; 5] = [
    None,
    Some((8.0, 4.0)),
    Some((2.0, 3.0)),
    Some((14.0, 5.0)),
    Some((5.0, 2.0)),
];

/// Of the series of a number: no two of the first twelve share a shape.
pub fn look(index: usize) -> Look {
    let (shape, filled) = SHAPES[index % SHAPES.len()];
    Look {
        colour: COLOURS[index % COLOURS.len()],
        shape,
        filled,
        dash: DASHES[index % DASHES.len()],
    }
}

impl Shape {
    /// Strokes about its middle \[px\], closed but for crosses; none for a circle.
    pub fn strokes(self, radius: f64) -> Vec<Vec<(f64, f64)>> {
        let r = radius;
        // As much ink as a circle's.
        let (s, t) = (0.89 * r, 1.25 * r);
        match self {
            Shape::Circle => Vec::new(),
            Shape::Square => vec![vec![(-s, -s), (s, -s), (s, s), (-s, s), (-s, -s)]],
            Shape::Up => vec![vec![(0.0, -t), (t, 0.8 * t), (-t, 0.8 * t), (0.0, -t)]],
            Shape::Down => vec![vec![(0.0, t), (t, -0.8 * t), (-t, -0.8 * t), (0.0, t)]],
            Shape::Diamond => vec![vec![(0.0, -t), (t, 0.0), (0.0, t), (-t, 0.0), (0.0, -t)]],
            Shape::Cross => vec![vec![(-s, -s), (s, s)], vec![(-s, s), (s, -s)]],
            Shape::Plus => vec![vec![(-r, 0.0), (r, 0.0)], vec![(0.0, -r), (0.0, r)]],
        }
    }

    /// Whether it can be filled.
    pub fn is_closed(self) -> bool {
        !matches!(self, Shape::Cross | Shape::Plus)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In grey as well, by marks; and lines that are beside each other by dashes.
    #[test]
    fn no_two_of_twelve_look_alike_without_their_colours() {
        let looks: Vec<Look> = (0..12).map(look).collect();
        for (index, one) in looks.iter().enumerate() {
            let alike = |other: &Look| (other.shape, other.filled) == (one.shape, one.filled);
            assert!(!looks[..index].iter().any(alike), "{index}");
        }
        for pair in looks.windows(DASHES.len()) {
            assert!(pair[1..].iter().all(|other| other.dash != pair[0].dash));
        }
    }
}
