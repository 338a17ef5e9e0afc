//! One picture: a frame with its grid and data, titles around it, and a legend beside it.
//!
//! Entry point: [`Chart::svg`]. The plotting library maps coordinates, draws and writes; what stands where is decided
//! here, because everything that is written must be legible whatever the data are.

use crate::Error;
use crate::axis::{Axis, Label, Place, RAISED, Scale, Tick};
use crate::labels::{Placed, Region, Wanted, place};
use crate::marks::{Look, Shape, look};
use crate::text::{width, wrapped};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::{Circle, DashedPathElement, EmptyElement, PathElement, Polygon, Text};
use plotters::prelude::{Cartesian2d, DrawingArea, IntoDrawingArea, SVGBackend};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{
    BLACK, Color, FontTransform, IntoFont, RGBColor, ShapeStyle, TextStyle, WHITE,
};

/// Width, and least height \[px\]: long legends need more.
const WIDTH: f64 = 800.0;
const HEIGHT: f64 = 480.0;
/// Units of the file in one of these: the library has whole numbers only.
const UNITS: f64 = 10.0;
/// Letters \[px\].
const TITLE: f64 = 15.0;
const WORDS: f64 = 13.0;
const SMALL: f64 = 12.0;
/// From one line of words to the next \[px\].
const LINE: f64 = 17.0;
/// Room between things and at the edge \[px\].
const GAP: f64 = 8.0;
/// Sample of a line or a mark in the legend \[px\].
const SAMPLE: f64 = 30.0;
/// Most that the legend's words take \[px\].
const LEGEND: f64 = 190.0;
/// Radius of a mark \[px\].
const RADIUS: f64 = 4.0;
/// Length of an arrow at the edge \[px\].
const ARROW: f64 = 6.8;
/// Joined points beyond which only some have marks.
const MANY: usize = 24;
const GRID: RGBColor = RGBColor(0xd4, 0xd4, 0xd4);
const FINE: RGBColor = RGBColor(0xee, 0xee, 0xee);
/// Lines under the legend's names: what is missing, and most that a note has.
const MISSING_LINES: usize = 7;
const NOTE_LINES: usize = 6;
/// Middle of capitals below the height at which the library places them, em.
const MIDDLE: f64 = 0.4;
/// The library's sizes are of boxes around letters; those of the file are of letters.
const BOX_OF_LETTERS: f64 = 1.24;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shown {
    /// A mark for each point. What lies far from the rest is marked at the edge.
    #[default]
    Scattered,
    /// A line through marks.
    Joined,
    /// A black line: what bounds the rest.
    Bound,
}

/// Points of a name.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// In the legend.
    pub name: String,
    /// In order.
    pub points: Vec<(f64, f64)>,
    /// Beside the first points, one each; empty ones and those that find no room are left out.
    pub labels: Vec<String>,
    /// Lines or marks.
    pub shown: Shown,
}

/// One picture.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// Above it.
    pub title: String,
    /// Under the legend.
    pub note: String,
    /// To the right.
    pub x: Axis,
    /// Upwards.
    pub y: Axis,
    /// What it shows, in the legend's order.
    pub series: Vec<Series>,
}

/// Points that are not where they belong.
#[derive(Debug, Default)]
struct Missing {
    /// Beyond the left, right, lower and upper edge.
    beyond: [usize; 4],
    not_above_zero: usize,
    no_number: usize,
    labels: usize,
}

/// What stands where.
struct Layout {
    height: f64,
    /// Around the data.
    frame: Region,
    title: Vec<String>,
    /// Lines of each name.
    names: Vec<Vec<String>>,
    scales: (Scale, Scale),
    ticks: (Vec<Tick>, Vec<Tick>),
}

type Page<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Plot<'a> = DrawingArea<SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A point in the frame, and the way to where it belongs if that is beyond.
struct Shadow {
    at: (f64, f64),
    outwards: Option<(i32, i32)>,
}

fn drawing(error: impl std::fmt::Display) -> Error {
    Error::Drawing(error.to_string())
}

fn units(value: f64) -> i32 {
    (UNITS * value).round() as i32
}

impl Chart {
    /// As a file.
    ///
    /// # Errors
    /// If the plotting library cannot draw, which no data makes it do.
    pub fn svg(&self) -> Result<String, Error> {
        let layout = self.layout();
        let mut svg = String::new();
        {
            let size = (units(WIDTH) as u32, units(layout.height) as u32);
            let page = SVGBackend::with_string(&mut svg, size).into_drawing_area();
            page.fill(&WHITE).map_err(drawing)?;
            self.draw(&page, &layout)?;
            page.present().map_err(drawing)?;
        }
        // The library's width is that of its units.
        let size = |width: f64, height: f64| format!("width=\"{width}\" height=\"{height}\"");
        let wide = size(UNITS * WIDTH, UNITS * layout.height);
        Ok(svg.replacen(&wide, &size(WIDTH, layout.height), 1))
    }

    fn layout(&self) -> Layout {
        let scales = self.scales();
        let title = wrapped(&self.title, TITLE, WIDTH - 4.0 * GAP, 2);
        let series = self.series.iter();
        let names: Vec<_> = series
            .map(|series| wrapped(&series.name, SMALL, LEGEND, 2))
            .collect();
        let words = names.iter().flatten().map(|line| width(line, SMALL));
        let legend = SAMPLE + GAP + words.fold(110.0, f64::max);
        let top = 3.5 * GAP + TITLE + LINE * title.len().saturating_sub(1) as f64;
        let lines = names.iter().map(Vec::len).sum::<usize>() + MISSING_LINES + NOTE_LINES;
        let height = HEIGHT.max(top + LINE * lines as f64 + 3.0 * GAP);
        let mut frame = Region {
            left: 0.0,
            top,
            right: WIDTH - legend - 3.0 * GAP,
            bottom: height - 4.0 * GAP - 2.0 * WORDS,
        };
        let y_room = (frame.bottom - frame.top) / (scales.1.high - scales.1.low);
        let y_ticks = scales
            .1
            .ticks(|ticks| apart(ticks, y_room, |_| SMALL + 6.0));
        let labels = y_ticks.iter().filter_map(|tick| tick.label.as_ref());
        let widest = labels.map(|label| label.width(SMALL)).fold(0.0, f64::max);
        frame.left = 3.0 * GAP + WORDS + widest;
        let x_room = (frame.right - frame.left) / (scales.0.high - scales.0.low);
        let of_words = |label: &Label| label.width(SMALL) + 10.0;
        let x_ticks = scales.0.ticks(|ticks| apart(ticks, x_room, of_words));
        Layout {
            height,
            frame,
            title,
            names,
            scales,
            ticks: (x_ticks, y_ticks),
        }
    }

    fn draw(&self, page: &Page, layout: &Layout) -> Result<(), Error> {
        let Layout { scales, frame, .. } = layout;
        let plot = page.clone().apply_coord_spec(Cartesian2d::new(
            scales.0.low..scales.0.high,
            scales.1.low..scales.1.high,
            (
                units(frame.left)..units(frame.right),
                units(frame.bottom)..units(frame.top),
            ),
        ));
        draw_grid(&plot, scales, &layout.ticks)?;
        draw_tick_labels(page, &plot, frame, &layout.ticks)?;
        self.draw_titles(page, layout)?;
        let mut missing = Missing::default();
        for (index, series) in self.series.iter().enumerate() {
            draw_series(
                &plot,
                scales,
                series,
                (index, self.look(index)),
                &mut missing,
            )?;
        }
        missing.labels = self.draw_labels(page, &plot, layout)?;
        self.draw_legend(page, layout, &missing)
    }

    fn scales(&self) -> (Scale, Scale) {
        let of = |is_scattered: bool, pick: fn(&(f64, f64)) -> f64| -> Vec<f64> {
            let series = self.series.iter();
            let series = series.filter(|series| (series.shown == Shown::Scattered) == is_scattered);
            series.flat_map(|series| &series.points).map(pick).collect()
        };
        (
            Scale::over(&self.x, &of(false, |p| p.0), &of(true, |p| p.0)),
            Scale::over(&self.y, &of(false, |p| p.1), &of(true, |p| p.1)),
        )
    }

    /// Bounds are no kind among others: they take no look from them.
    fn look(&self, index: usize) -> Look {
        let kinds = |series: &&Series| series.shown != Shown::Bound;
        match self.series.get(index) {
            Some(series) if series.shown == Shown::Bound => Look {
                colour: BLACK,
                dash: None,
                ..look(0)
            },
            _ => look(self.series.iter().take(index).filter(kinds).count()),
        }
    }

    fn draw_titles(&self, page: &Page, layout: &Layout) -> Result<(), Error> {
        let frame = &layout.frame;
        for (index, line) in layout.title.iter().enumerate() {
            let y = 1.5 * GAP + LINE * index as f64;
            write(page, line, (2.0 * GAP, y), TITLE, HPos::Left)?;
        }
        let middle = 0.5 * (frame.left + frame.right);
        let bottom = layout.height - GAP - WORDS;
        for line in wrapped(&self.x.title, WORDS, frame.right - frame.left, 1) {
            write(page, &line, (middle, bottom), WORDS, HPos::Center)?;
        }
        for line in wrapped(&self.y.title, WORDS, frame.bottom - frame.top, 1) {
            let style = style(WORDS, HPos::Center).transform(FontTransform::Rotate270);
            let at = (units(GAP), units(0.5 * (frame.top + frame.bottom)));
            page.draw(&Text::new(line, at, style)).map_err(drawing)?;
        }
        Ok(())
    }

    /// How many found no room.
    fn draw_labels(&self, page: &Page, plot: &Plot, layout: &Layout) -> Result<usize, Error> {
        let Layout { scales, frame, .. } = layout;
        let pixel = |point: &(f64, f64)| {
            let shadow = shadow(scales, point).ok()?;
            let (x, y) = plot.map_coordinate(&shadow.at);
            Some((f64::from(x) / UNITS, f64::from(y) / UNITS))
        };
        let points = self.series.iter().flat_map(|series| &series.points);
        let marks: Vec<_> = points.filter_map(pixel).collect();
        let labelled = self
            .series
            .iter()
            .flat_map(|series| series.points.iter().zip(&series.labels));
        let wanted: Vec<_> = labelled
            .filter(|(_, words)| !words.is_empty())
            .filter_map(|(point, words)| {
                let (x, y) = pixel(point)?;
                let words = words.clone();
                Some(Wanted { x, y, words })
            })
            .collect();
        let places = place(&wanted, &marks, *frame, SMALL);
        for (label, placed) in wanted.iter().zip(&places) {
            let Some(Placed { x, y, leader }) = *placed else {
                continue;
            };
            if leader {
                let end = |x, y| (units(x), units(y));
                // From beside the mark to beside the words.
                let (dx, dy) = (x - label.x, y - label.y);
                let length = libm::hypot(dx, dy);
                let (from, to) = (RADIUS / length, 1.0 - 0.7 * SMALL / length);
                let ends = [from, to].map(|part| end(label.x + part * dx, label.y + part * dy));
                page.draw(&PathElement::new(ends, stroke(BLACK, 0.7)))
                    .map_err(drawing)?;
            }
            write(
                page,
                &label.words,
                (x, y - MIDDLE * SMALL),
                SMALL,
                HPos::Center,
            )?;
        }
        Ok(places.iter().filter(|place| place.is_none()).count())
    }

    fn draw_legend(&self, page: &Page, layout: &Layout, missing: &Missing) -> Result<(), Error> {
        let Layout { frame, names, .. } = layout;
        let left = frame.right + 2.0 * GAP;
        let words = left + SAMPLE + GAP;
        let mut top = frame.top;
        for (index, (series, lines)) in self.series.iter().zip(names).enumerate() {
            let look = self.look(index);
            let y = top + MIDDLE * SMALL;
            if series.shown != Shown::Scattered {
                let ends = [left, left + SAMPLE].map(|x| (units(x), units(y)));
                draw_line(page, ends.to_vec(), look, line_width(series.shown))?;
            }
            if series.shown != Shown::Bound {
                draw_mark(page, (units(left + 0.5 * SAMPLE), units(y)), look)?;
            }
            for line in lines {
                write(page, line, (words, top), SMALL, HPos::Left)?;
                top += LINE;
            }
        }
        top += GAP;
        let mut said = missing.said();
        if self.series.iter().all(|series| series.points.is_empty()) {
            said.push((None, "no points".to_owned()));
        }
        for (outwards, line) in said {
            if let Some(outwards) = outwards {
                // Its middle, not its foot.
                let back = |way: i32| 0.5 * ARROW * f64::from(way);
                let at = (
                    units(left + 0.5 * SAMPLE - back(outwards.0)),
                    units(top + MIDDLE * SMALL - back(outwards.1)),
                );
                draw_arrow(page, at, outwards, BLACK)?;
            }
            write(page, &line, (words, top), SMALL, HPos::Left)?;
            top += LINE;
        }
        top += GAP;
        for line in wrapped(&self.note, SMALL, WIDTH - left - GAP, NOTE_LINES) {
            write(page, &line, (left, top), SMALL, HPos::Left)?;
            top += LINE;
        }
        Ok(())
    }
}

impl Missing {
    fn count(&mut self, place: &Place) {
        match place {
            Place::NotAboveZero => self.not_above_zero += 1,
            Place::NoNumber => self.no_number += 1,
            Place::Inside(_) | Place::Below | Place::Above => {}
        }
    }

    /// Lines of the legend, with the way to what they count.
    fn said(&self) -> Vec<(Option<(i32, i32)>, String)> {
        let edges = [(-1, 0), (1, 0), (0, 1), (0, -1)];
        let beyond = edges.into_iter().zip(self.beyond);
        let beyond = beyond.map(|(way, count)| (Some(way), count, "beyond"));
        let others = [
            (self.not_above_zero, "not above 0"),
            (self.no_number, "no numbers"),
            (self.labels, "labels: no room"),
        ];
        let others = others.map(|(count, what)| (None, count, what));
        let all = beyond.chain(others).filter(|(_, count, _)| *count > 0);
        all.map(|(way, count, what)| (way, format!("{count} {what}")))
            .collect()
    }
}

/// Where a point is drawn, or why it is not.
fn shadow(scales: &(Scale, Scale), point: &(f64, f64)) -> Result<Shadow, Place> {
    let along = |scale: &Scale, value: f64| match scale.place(value) {
        Place::Inside(at) => Ok((at, 0)),
        Place::Below => Ok((scale.low, -1)),
        Place::Above => Ok((scale.high, 1)),
        unsuited => Err(unsuited),
    };
    let (x, right) = along(&scales.0, point.0)?;
    let (y, up) = along(&scales.1, point.1)?;
    let outwards = (right, -up);
    Ok(Shadow {
        at: (x, y),
        outwards: (outwards != (0, 0)).then_some(outwards),
    })
}

fn draw_grid(
    plot: &Plot,
    scales: &(Scale, Scale),
    (x, y): &(Vec<Tick>, Vec<Tick>),
) -> Result<(), Error> {
    let line = |from, to, tick: &Tick| {
        let colour = if tick.label.is_some() { GRID } else { FINE };
        plot.draw(&PathElement::new(vec![from, to], stroke(colour, 1.0)))
            .map_err(drawing)
    };
    // Fine lines first: they are under the others.
    for labelled in [false, true] {
        for tick in x.iter().filter(|tick| tick.label.is_some() == labelled) {
            line((tick.at, scales.1.low), (tick.at, scales.1.high), tick)?;
        }
        for tick in y.iter().filter(|tick| tick.label.is_some() == labelled) {
            line((scales.0.low, tick.at), (scales.0.high, tick.at), tick)?;
        }
    }
    let corners = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)];
    let corner = |(right, up): (u8, u8)| {
        (
            if right == 1 {
                scales.0.high
            } else {
                scales.0.low
            },
            if up == 1 { scales.1.high } else { scales.1.low },
        )
    };
    let corners: Vec<_> = corners.into_iter().map(corner).collect();
    plot.draw(&PathElement::new(corners, stroke(BLACK, 1.0)))
        .map_err(drawing)
}

fn draw_series(
    plot: &Plot,
    scales: &(Scale, Scale),
    series: &Series,
    (number, look): (usize, Look),
    missing: &mut Missing,
) -> Result<(), Error> {
    let shadows = series.points.iter().map(|point| shadow(scales, point));
    let shadows: Vec<_> = shadows.collect();
    for shadow in &shadows {
        match shadow {
            Err(unsuited) => missing.count(unsuited),
            Ok(Shadow {
                outwards: Some((right, down)),
                ..
            }) => {
                // A corner counts once.
                let edge = match (right, down) {
                    (_, -1) => 3,
                    (_, 1) => 2,
                    (-1, _) => 0,
                    _ => 1,
                };
                missing.beyond[edge] += 1;
            }
            Ok(_) => {}
        }
    }
    if series.shown != Shown::Scattered {
        // What has no place parts the line; what is beyond ends it at the edge.
        for part in shadows.split(Result::is_err) {
            let line: Vec<_> = part.iter().flatten().map(|shadow| shadow.at).collect();
            if line.len() > 1 {
                draw_line(plot, line, look, line_width(series.shown))?;
            }
        }
    }
    let every = if series.shown == Shown::Joined && shadows.len() > MANY {
        shadows.len().div_ceil(8)
    } else {
        1
    };
    // Where lines are one, marks of one do not lie under those of another.
    let first = number * every / 5 % every;
    for (index, shadow) in shadows.iter().flatten().enumerate() {
        match shadow.outwards {
            Some(outwards) => draw_arrow(plot, shadow.at, outwards, look.colour)?,
            None if series.shown != Shown::Bound && index % every == first => {
                draw_mark(plot, shadow.at, look)?;
            }
            None => {}
        }
    }
    Ok(())
}

fn draw_line<C>(
    area: &DrawingArea<SVGBackend, C>,
    points: Vec<C::From>,
    look: Look,
    width: f64,
) -> Result<(), Error>
where
    C: plotters::coord::CoordTranslate,
    C::From: Clone + 'static,
{
    let style = stroke(look.colour, width);
    match look.dash {
        None => area.draw(&PathElement::new(points, style)).map_err(drawing),
        Some((dash, gap)) => {
            let dashed = DashedPathElement::new(points, units(dash), units(gap), style);
            area.draw(&dashed).map_err(drawing)
        }
    }
}

fn draw_mark<C>(area: &DrawingArea<SVGBackend, C>, at: C::From, look: Look) -> Result<(), Error>
where
    C: plotters::coord::CoordTranslate,
    C::From: Clone,
{
    let line = stroke(look.colour, 1.4);
    if look.shape == Shape::Circle {
        let style = if look.filled { line.filled() } else { line };
        let mark = EmptyElement::at(at) + Circle::new((0, 0), units(RADIUS), style);
        return area.draw(&mark).map_err(drawing);
    }
    for path in look.shape.strokes(RADIUS) {
        let path: Vec<_> = path
            .into_iter()
            .map(|(x, y)| (units(x), units(y)))
            .collect();
        if look.filled && look.shape.is_closed() {
            let mark = EmptyElement::at(at.clone()) + Polygon::new(path, look.colour);
            area.draw(&mark).map_err(drawing)?;
        } else {
            let mark = EmptyElement::at(at.clone()) + PathElement::new(path, line);
            area.draw(&mark).map_err(drawing)?;
        }
    }
    Ok(())
}

/// From the edge outwards: what belongs beyond it.
fn draw_arrow<C>(
    area: &DrawingArea<SVGBackend, C>,
    at: C::From,
    outwards: (i32, i32),
    colour: RGBColor,
) -> Result<(), Error>
where
    C: plotters::coord::CoordTranslate,
    C::From: Clone,
{
    let (x, y) = (f64::from(outwards.0), f64::from(outwards.1));
    let corner = |along: f64, aside: f64| {
        (
            units(RADIUS * (along * x - aside * y)),
            units(RADIUS * (along * y + aside * x)),
        )
    };
    let path = vec![
        corner(0.0, -1.0),
        corner(ARROW / RADIUS, 0.0),
        corner(0.0, 1.0),
    ];
    let arrow = EmptyElement::at(at) + Polygon::new(path, colour);
    area.draw(&arrow).map_err(drawing)
}

fn draw_tick_labels(
    page: &Page,
    plot: &Plot,
    frame: &Region,
    (x, y): &(Vec<Tick>, Vec<Tick>),
) -> Result<(), Error> {
    let labelled = |ticks: &[Tick]| -> Vec<(f64, Label)> {
        let each = ticks.iter();
        each.filter_map(|tick| Some((tick.at, tick.label.clone()?)))
            .collect()
    };
    for (at, label) in labelled(x) {
        let middle = f64::from(plot.map_coordinate(&(at, 0.0)).0) / UNITS;
        let left = middle - 0.5 * label.width(SMALL);
        write_label(page, &label, (left, frame.bottom + GAP))?;
    }
    for (at, label) in labelled(y) {
        let middle = f64::from(plot.map_coordinate(&(0.0, at)).1) / UNITS;
        let left = frame.left - GAP - label.width(SMALL);
        write_label(page, &label, (left, middle - MIDDLE * SMALL))?;
    }
    Ok(())
}

/// The exponent begins where the base ends, in whatever font.
fn write_label(page: &Page, label: &Label, (left, top): (f64, f64)) -> Result<(), Error> {
    let middle = left + width(&label.base, SMALL);
    write(page, &label.base, (middle, top), SMALL, HPos::Right)?;
    if label.exponent.is_empty() {
        return Ok(());
    }
    write(
        page,
        &label.exponent,
        (middle, top - 0.35 * SMALL),
        RAISED * SMALL,
        HPos::Left,
    )
}

/// Whether ticks stand apart, each taking so much room of an axis with so many \[px\] in one of its coordinate.
fn apart(ticks: &[Tick], scale: f64, room: impl Fn(&Label) -> f64) -> bool {
    ticks.windows(2).all(|pair| {
        let rooms = pair
            .iter()
            .filter_map(|tick| tick.label.as_ref())
            .map(&room);
        (pair[1].at - pair[0].at) * scale >= 0.5 * rooms.sum::<f64>()
    })
}

fn line_width(shown: Shown) -> f64 {
    if shown == Shown::Bound { 1.6 } else { 1.8 }
}

fn stroke(colour: RGBColor, width: f64) -> ShapeStyle {
    colour.stroke_width(units(width) as u32)
}

fn style(size: f64, across: HPos) -> TextStyle<'static> {
    let font = ("sans-serif", (BOX_OF_LETTERS * UNITS * size).round()).into_font();
    TextStyle::from(font)
        .color(&BLACK)
        .pos(Pos::new(across, VPos::Top))
}

/// Words whose capitals begin at a height.
fn write(
    page: &Page,
    words: &str,
    (x, top): (f64, f64),
    size: f64,
    across: HPos,
) -> Result<(), Error> {
    let at = (units(x), units(top));
    page.draw(&Text::new(words, at, style(size, across)))
        .map_err(drawing)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is beyond is counted once, and so is what has no place at all.
    #[test]
    fn what_is_missing_is_counted() {
        let mut points: Vec<_> = (1..30).map(|i| (f64::from(i), f64::from(i))).collect();
        points.extend([
            (5.0, 1e10),
            (6.0, f64::NAN),
            (f64::INFINITY, 1.0),
            (-1.0, 2.0),
            (3.0, 0.0),
        ]);
        let logarithmic = Axis {
            logarithmic: true,
            ..Axis::default()
        };
        let chart = Chart {
            x: logarithmic.clone(),
            y: logarithmic,
            series: vec![Series {
                points,
                ..Series::default()
            }],
            ..Chart::default()
        };
        let svg = chart.svg().expect("a picture");
        for words in ["1 beyond", "2 not above 0", "2 no numbers"] {
            assert!(svg.contains(words), "{words}: {svg}");
        }
    }
}
