//! Every word of every picture can be read: it lies over no other and within the picture, in the widest of usual fonts.

use roxmltree::{Document, Node};
use std::path::{Path, PathBuf};
use sutura_plot::{Axis, Chart, Series, Shown};
use ttf_parser::Face;

const FONT: &[u8] = include_bytes!("fonts/DejaVuSans-subset.ttf");
/// Smaller letters are not read at 800 px \[px\].
const LEAST_SIZE: f64 = 9.0;
/// An exponent begins where its base ends \[px\].
const TOUCH: f64 = 0.2;

/// Ink of some words \[px\], y downwards.
#[derive(Clone, Debug)]
struct Ink {
    words: String,
    size: f64,
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Ink {
    fn overlaps(&self, other: &Ink) -> bool {
        self.left + TOUCH < other.right
            && other.left + TOUCH < self.right
            && self.top + TOUCH < other.bottom
            && other.top + TOUCH < self.bottom
    }
}

fn number(node: Node, name: &str) -> Option<f64> {
    node.attribute(name)?.parse().ok()
}

/// As inherited.
fn size(node: Node) -> f64 {
    node.ancestors()
        .find_map(|node| number(node, "font-size"))
        .expect("letters have a size")
}

/// Advance, and how far letters reach above and below their line \[px\].
fn extent(face: &Face, words: &str, size: f64) -> (f64, f64, f64) {
    let scale = size / f64::from(face.units_per_em());
    let (mut advance, mut above, mut below) = (0.0, 0.0f64, 0.0f64);
    for c in words.chars() {
        let glyph = face.glyph_index(c);
        let glyph = glyph.unwrap_or_else(|| panic!("the tests' font lacks `{c}`"));
        advance += scale * f64::from(face.glyph_hor_advance(glyph).unwrap_or_default());
        if let Some(ink) = face.glyph_bounding_box(glyph) {
            above = above.max(scale * f64::from(ink.y_max));
            below = below.max(scale * -f64::from(ink.y_min));
        }
    }
    (advance, above, below)
}

/// As placed, in units of the file.
fn ink(face: &Face, node: Node) -> Option<Ink> {
    let words = node.text()?.trim().to_owned();
    if words.is_empty() {
        return None;
    }
    let size = size(node);
    let (advance, above, below) = extent(face, &words, size);
    let shift = match node.attribute("dy").map(|dy| dy.split_at(dy.len() - 2)) {
        None => 0.0,
        Some((part, "em")) => size * part.parse::<f64>().expect("a number"),
        Some(other) => panic!("dy is {other:?}"),
    };
    let before = match node.attribute("text-anchor") {
        None | Some("start") => 0.0,
        Some("middle") => 0.5,
        Some("end") => 1.0,
        Some(other) => panic!("text-anchor is {other}"),
    };
    let (left, right) = (-before * advance, (1.0 - before) * advance);
    let (top, bottom) = (shift - above, shift + below);
    let numbers: Vec<f64> = node
        .attribute("transform")
        .unwrap_or_default()
        .split(|c: char| !(c.is_ascii_digit() || c == '.' || c == '-'))
        .filter_map(|part| part.parse().ok())
        .collect();
    let (x, y) = (number(node, "x"), number(node, "y"));
    let upright = |x: f64, y: f64| (x + left, x + right, y + top, y + bottom);
    // A quarter to the left: along is upwards, down is to the right.
    let turned = |x: f64, y: f64| (x + top, x + bottom, y - right, y - left);
    let (left, right, top, bottom) = match numbers[..] {
        [] => upright(x?, y?),
        [270.0, x, y] => turned(x, y),
        [x, y, -90.0] => turned(x, y),
        _ => panic!("transform is {:?}", node.attribute("transform")),
    };
    Some(Ink {
        words,
        size,
        left,
        right,
        top,
        bottom,
    })
}

/// What cannot be read, in words; and all words there are.
fn look(svg: &str) -> (Vec<String>, Vec<Ink>) {
    let face = Face::parse(FONT, 0).expect("a font");
    let document = Document::parse(svg).expect("XML");
    let root = document.root_element();
    let area: Vec<f64> = root
        .attribute("viewBox")
        .expect("a size")
        .split(' ')
        .map(|part| part.parse().expect("a number"))
        .collect();
    // All in px of the picture as it is shown.
    let scale = area[2] / number(root, "width").unwrap_or(area[2]);
    let texts = document
        .descendants()
        .filter(|node| node.has_tag_name("text"));
    let scaled = |ink: Ink| Ink {
        size: ink.size / scale,
        left: ink.left / scale,
        right: ink.right / scale,
        top: ink.top / scale,
        bottom: ink.bottom / scale,
        ..ink
    };
    let inks: Vec<Ink> = texts
        .filter_map(|node| ink(&face, node))
        .map(scaled)
        .collect();
    let (width, height) = (area[2] / scale, area[3] / scale);
    let mut wrong = Vec::new();
    for (index, one) in inks.iter().enumerate() {
        if one.left < 0.0 || one.top < 0.0 || one.right > width || one.bottom > height {
            wrong.push(format!("`{}` leaves the picture: {one:?}", one.words));
        }
        if one.size < LEAST_SIZE {
            wrong.push(format!("`{}` has letters of {} px", one.words, one.size));
        }
        for other in inks[..index].iter().filter(|other| one.overlaps(other)) {
            wrong.push(format!("`{}` lies over `{}`", one.words, other.words));
        }
    }
    (wrong, inks)
}

/// Left, top, right and bottom of the frame around the data \[px\]: the black line that ends where it begins.
fn frame(svg: &str) -> [f64; 4] {
    let document = Document::parse(svg).expect("XML");
    let lines = document
        .descendants()
        .filter(|node| node.has_tag_name("polyline"));
    let corners = lines.filter(|node| node.attribute("stroke") == Some("#000000"));
    let corners = corners.filter_map(|node| {
        let points = node.attribute("points")?.split_whitespace();
        let points: Vec<(f64, f64)> = points
            .filter_map(|point| {
                let (x, y) = point.split_once(',')?;
                Some((0.1 * x.parse::<f64>().ok()?, 0.1 * y.parse::<f64>().ok()?))
            })
            .collect();
        (points.len() == 5 && points[0] == points[4]).then_some(points)
    });
    let corners = corners.into_iter().next().expect("a frame");
    let all = |pick: fn(&(f64, f64)) -> f64| corners.iter().map(pick).collect::<Vec<_>>();
    let (x, y) = (all(|point| point.0), all(|point| point.1));
    let least = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    [least(&x), least(&y), most(&x), most(&y)]
}

/// Words that lie over the data.
fn inside(svg: &str) -> Vec<String> {
    let [left, top, right, bottom] = frame(svg);
    let (_, inks) = look(svg);
    let over = inks
        .into_iter()
        .filter(|ink| ink.left < right && ink.right > left && ink.top < bottom && ink.bottom > top);
    over.map(|ink| ink.words).collect()
}

fn pictures(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("readable");
    let paths = entries.map(|entry| entry.expect("readable").path());
    let each = paths.flat_map(|path| {
        if path.is_dir() {
            pictures(&path)
        } else {
            vec![path]
        }
    });
    each.filter(|path| path.extension().is_some_and(|end| end == "svg"))
        .collect()
}

#[test]
fn every_picture_of_the_book_can_be_read() {
    let book = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src");
    let pictures = pictures(&book);
    assert!(pictures.len() >= 13, "{pictures:?}");
    let mut all = Vec::new();
    for path in &pictures {
        let svg = std::fs::read_to_string(path).expect("readable");
        let name = path.file_name().expect("a name").to_string_lossy();
        let (wrong, inks) = look(&svg);
        assert!(inks.len() > 10, "{name}");
        all.extend(wrong.into_iter().map(|what| format!("{name}: {what}")));
    }
    assert!(all.is_empty(), "{} in all\n{}", all.len(), all.join("\n"));
    for path in &pictures {
        let svg = std::fs::read_to_string(path).expect("readable");
        // A drawing of wires has no data.
        let is_drawing = path
            .parent()
            .is_some_and(|folder| folder.ends_with("wiring"));
        let over = if is_drawing { Vec::new() } else { inside(&svg) };
        let is_number = |words: &String| words.parse::<u32>().is_ok();
        assert!(over.iter().all(is_number), "{}: {over:?}", path.display());
        assert!(
            svg.contains("font-family=\"sans-serif\""),
            "{}",
            path.display()
        );
    }
}

const SHOWN: [Shown; 3] = [Shown::Scattered, Shown::Joined, Shown::Bound];
const AXES: [(bool, bool); 4] = [(false, false), (true, false), (false, true), (true, true)];

/// The same points in every way in which they can be shown; each picture is looked at.
fn readable(name: &str, points: &[(f64, f64)], say: &[&str]) {
    for shown in SHOWN {
        for (x, y) in AXES {
            for labelled in [false, true] {
                let axis = |title: &str, logarithmic| Axis {
                    title: title.to_owned(),
                    logarithmic,
                    most: None,
                };
                let labels = (1..=points.len()).map(|number| number.to_string());
                let chart = Chart {
                    title: format!("{name}: <a> & \"b\""),
                    note: "what there is to say".to_owned(),
                    x: axis("time of a step [ms]", x),
                    y: axis("largest error [%]", y),
                    series: vec![
                        Series {
                            name: "one".to_owned(),
                            points: points.to_vec(),
                            labels: if labelled {
                                labels.collect()
                            } else {
                                Vec::new()
                            },
                            shown,
                        },
                        Series {
                            name: "none".to_owned(),
                            ..Series::default()
                        },
                    ],
                };
                let svg = chart.svg().expect("a picture");
                let (wrong, inks) = look(&svg);
                let what = format!("{name}, {shown:?}, logarithmic {x} {y}, labelled {labelled}");
                assert!(wrong.is_empty(), "{what}:\n{}\n{svg}", wrong.join("\n"));
                for words in say {
                    let is_said = inks.iter().any(|ink| ink.words == *words);
                    assert!(is_said, "{what}: does not say `{words}`");
                }
                let [left, top, right, bottom] = frame(&svg);
                assert!(right - left > 300.0 && bottom - top > 200.0, "{what}");
            }
        }
    }
}

#[test]
fn one_point_far_away_hides_nothing() {
    let mut points: Vec<_> = (1..=30)
        .map(|i| (f64::from(i), 1.0 + f64::from(i * 7 % 30)))
        .collect();
    points.push((15.0, 1e10));
    readable("one at 1e10", &points, &[]);
    let chart = Chart {
        series: vec![Series {
            points: points.clone(),
            ..Series::default()
        }],
        ..Chart::default()
    };
    let (_, inks) = look(&chart.svg().expect("a picture"));
    assert!(inks.iter().any(|ink| ink.words == "1 beyond"));
    points.push((1e-300, 1e300));
    points.push((1e300, 1e-300));
    readable("to the ends of numbers", &points, &[]);
}

#[test]
fn what_is_at_one_place_can_be_read() {
    readable("forty at one place", &[(3.0, 7.0); 40], &[]);
    readable("one", &[(3.0, 7.0)], &[]);
    readable("all small", &[(3e-9, 7e-12), (3.1e-9, 7e-12)], &[]);
    readable(
        "all large and near",
        &[(1e10, 1e10), (1e10 + 1.0, 1e10 + 2.0)],
        &[],
    );
    readable("no points", &[], &["no points"]);
    readable("both signs", &[(-3.0, -2e5), (5.0, 3e5), (1.0, 1.0)], &[]);
}

#[test]
fn what_has_no_place_is_counted() {
    let points = [
        (1.0, 2.0),
        (2.0, f64::NAN),
        (f64::INFINITY, 3.0),
        (3.0, f64::NEG_INFINITY),
        (4.0, 5.0),
    ];
    readable("no numbers", &points, &["3 no numbers"]);
    readable(
        "nothing but no numbers",
        &[(f64::NAN, 1.0); 4],
        &["4 no numbers"],
    );
    let chart = |x, y| Chart {
        x: Axis {
            logarithmic: x,
            ..Axis::default()
        },
        y: Axis {
            logarithmic: y,
            ..Axis::default()
        },
        series: vec![Series {
            points: vec![(1.0, 2.0), (-2.0, 5.0), (3.0, 0.0), (4.0, -4.0), (9.0, 9.0)],
            ..Series::default()
        }],
        ..Chart::default()
    };
    for (axes, said) in AXES.into_iter().zip([
        None,
        Some("1 not above 0"),
        Some("2 not above 0"),
        Some("3 not above 0"),
    ]) {
        let (wrong, inks) = look(&chart(axes.0, axes.1).svg().expect("a picture"));
        assert!(wrong.is_empty(), "{wrong:?}");
        let own = inks.iter().find(|ink| ink.words.contains("not above 0"));
        assert_eq!(own.map(|ink| ink.words.as_str()), said, "{axes:?}");
    }
}

#[test]
fn long_names_and_many_are_broken_or_cut() {
    let series = (0..60).map(|number| Series {
        name: format!(
            "a model of some kind with a name far too long for a legend, the {number}th of them all"
        ),
        points: vec![(f64::from(number), 1.0), (f64::from(number), 2.0)],
        labels: vec!["a label that is long".to_owned(); 2],
        shown: SHOWN[number as usize % 3],
    });
    let long = "an axis about which there is more to say than there is room for beside it, though it is wide enough, and more [m]";
    let axis = Axis {
        title: long.to_owned(),
        ..Axis::default()
    };
    let chart = Chart {
        title: long.repeat(3),
        note: long.repeat(9),
        x: axis.clone(),
        y: axis,
        series: series.collect(),
    };
    let svg = chart.svg().expect("a picture");
    let (wrong, inks) = look(&svg);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(inks.iter().any(|ink| ink.words.ends_with('\u{2026}')));
}
