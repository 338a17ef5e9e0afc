//! The wiring pages' drawings, from texts in `docs/wiring`: a thing a line, at places of a grid of ten pixels.
//!
//! Entry points: [`all`], [`draw`].
//!
//! | line | draws |
//! |---|---|
//! | `size W H` | the sheet; first |
//! | `block X Y W H TITLE` | a box with its title |
//! | `note X Y TEXT` | text that begins there |
//! | `pin X Y left` or `right TEXT` | a terminal, its text on that side |
//! | `wire X Y X Y ..` | a line; `dashed X Y X Y ..`: a limit |
//! | `dot X Y` | wires meet |
//! | `ground X Y`, `supply X Y TEXT` | where a wire ends |
//! | `resistor`, `capacitor`, `diode` or `contact X Y X Y TEXT` | a part between two places on a line; the contact is closed at rest |

use crate::run::root;
use anyhow::{Context, Result, bail};
use std::fmt::Write;
use std::fs;
use sutura_plot::Picture;

/// Pixels of the grid, and length of a part on its line.
const GRID: f64 = 10.0;
const PART: f64 = 34.0;

/// Every text's picture, by name.
pub fn all() -> Result<Vec<Picture>> {
    let folder = root().join("docs/wiring");
    let mut pictures = Vec::new();
    for entry in fs::read_dir(&folder).with_context(|| format!("reading {}", folder.display()))? {
        let path = entry?.path();
        let said = || format!("drawing {}", path.display());
        let text = fs::read_to_string(&path).with_context(said)?;
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let svg = draw(&text).with_context(said)?;
        pictures.push(Picture {
            name: format!("{stem}.svg"),
            svg,
        });
    }
    pictures.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(pictures)
}

/// Draws a text.
pub fn draw(text: &str) -> Result<String> {
    let mut svg = String::new();
    let lines = || (1..).zip(text.lines().map(str::trim));
    let is_end = |line: &str| line.starts_with("pin ") || line.starts_with("dot ");
    // Terminals and dots are over the wires that end there.
    let over = lines().filter(|(_, line)| is_end(line));
    for (number, line) in lines().filter(|(_, line)| !is_end(line)).chain(over) {
        if !line.is_empty() && !line.starts_with('#') {
            thing(&mut svg, line).with_context(|| format!("line {number}: `{line}`"))?;
        }
    }
    if !svg.starts_with("<svg") {
        bail!("no `size W H` before all else");
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// A line's numbers, in pixels, and the text after them.
fn parts(rest: &str, numbers: usize) -> Result<(Vec<f64>, String)> {
    let mut words = rest.split_whitespace();
    let found: Vec<f64> = words
        .by_ref()
        .take(numbers)
        .map(|word| word.parse::<f64>().map(|number| number * GRID))
        .collect::<Result<_, _>>()
        .with_context(|| format!("{numbers} numbers are wanted"))?;
    if found.len() < numbers {
        bail!(
            "{numbers} numbers are wanted, and there are {}",
            found.len()
        );
    }
    Ok((found, words.collect::<Vec<_>>().join(" ")))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

fn label(svg: &mut String, x: f64, y: f64, anchor: &str, text: &str) {
    let text = escaped(text);
    let _ = writeln!(
        svg,
        r#"<text x="{x}" y="{y}" text-anchor="{anchor}" stroke="none" fill="black">{text}</text>"#
    );
}

fn line(svg: &mut String, points: &[(f64, f64)], more: &str) {
    let places: Vec<_> = points.iter().map(|(x, y)| format!("{x},{y}")).collect();
    let _ = writeln!(svg, r#"<polyline points="{}"{more}/>"#, places.join(" "));
}

fn thing(svg: &mut String, text: &str) -> Result<()> {
    let (kind, rest) = text.split_once(' ').unwrap_or((text, ""));
    if kind != "size" && svg.is_empty() {
        bail!("`size W H` comes first");
    }
    match kind {
        "size" => {
            let (at, _) = parts(rest, 2)?;
            let [w, h] = [at[0], at[1]];
            let _ = write!(
                svg,
                "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
                 font-family=\"sans-serif\" font-size=\"13\" fill=\"none\" stroke=\"black\" stroke-width=\"1.5\">\n\
                 <rect width=\"{w}\" height=\"{h}\" fill=\"white\" stroke=\"none\"/>\n"
            );
        }
        "block" => {
            let (at, title) = parts(rest, 4)?;
            let _ = writeln!(
                svg,
                r##"<rect x="{}" y="{}" width="{}" height="{}" rx="4" fill="#eef3f8"/>"##,
                at[0], at[1], at[2], at[3]
            );
            label(svg, at[0] + 0.5 * at[2], at[1] + 18.0, "middle", &title);
        }
        "note" => {
            let (at, text) = parts(rest, 2)?;
            label(svg, at[0], at[1] + 4.0, "start", &text);
        }
        "pin" => {
            let (at, text) = parts(rest, 2)?;
            let (side, text) = text
                .split_once(' ')
                .context("`left` or `right`, and a text")?;
            let (x, anchor) = match side {
                "left" => (at[0] - 8.0, "end"),
                "right" => (at[0] + 8.0, "start"),
                _ => bail!("the text of a pin is `left` or `right` of it, not `{side}`"),
            };
            let _ = writeln!(
                svg,
                r#"<circle cx="{}" cy="{}" r="3.5" fill="white"/>"#,
                at[0], at[1]
            );
            label(svg, x, at[1] + 4.5, anchor, text);
        }
        "wire" | "dashed" => {
            let (at, _) = parts(rest, rest.split_whitespace().count())?;
            if at.len() < 4 || at.len() % 2 == 1 {
                bail!("a line goes from place to place");
            }
            let points: Vec<_> = at.chunks(2).map(|place| (place[0], place[1])).collect();
            let dashes = if kind == "dashed" {
                r#" stroke-dasharray="6 4""#
            } else {
                ""
            };
            line(svg, &points, dashes);
        }
        "dot" => {
            let (at, _) = parts(rest, 2)?;
            let _ = writeln!(
                svg,
                r#"<circle cx="{}" cy="{}" r="3" fill="black"/>"#,
                at[0], at[1]
            );
        }
        "ground" => {
            let (at, _) = parts(rest, 2)?;
            for (down, half) in [(0.0, 10.0), (4.0, 6.5), (8.0, 3.0)] {
                line(
                    svg,
                    &[(at[0] - half, at[1] + down), (at[0] + half, at[1] + down)],
                    "",
                );
            }
        }
        "supply" => {
            let (at, text) = parts(rest, 2)?;
            line(svg, &[(at[0] - 10.0, at[1]), (at[0] + 10.0, at[1])], "");
            label(svg, at[0], at[1] - 6.0, "middle", &text);
        }
        "resistor" | "capacitor" | "diode" | "contact" => {
            let (at, text) = parts(rest, 4)?;
            part(svg, kind, (at[0], at[1]), (at[2], at[3]), &text);
        }
        _ => bail!(
            "`{kind}` is no thing that can be drawn: see the top of xtask/src/plots/circuit.rs"
        ),
    }
    Ok(())
}

/// A part in the middle of a line from one place to another.
fn part(svg: &mut String, kind: &str, from: (f64, f64), to: (f64, f64), text: &str) {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1.0);
    let (ux, uy) = (dx / length, dy / length);
    // Along the line from its middle, and across.
    let at = |along: f64, across: f64| {
        let place =
            |middle: f64, u: f64, v: f64| ((middle + along * u + across * v) * 10.0).round() / 10.0;
        (
            place(0.5 * (from.0 + to.0), ux, -uy),
            place(0.5 * (from.1 + to.1), uy, ux),
        )
    };
    let half = match kind {
        "capacitor" => 3.0,
        "diode" => 7.0,
        _ => 0.5 * PART,
    };
    line(svg, &[from, at(-half, 0.0)], "");
    line(svg, &[at(half, 0.0), to], "");
    match kind {
        "resistor" => {
            let corners = [
                (-half, -6.0),
                (half, -6.0),
                (half, 6.0),
                (-half, 6.0),
                (-half, -6.0),
            ];
            line(
                svg,
                &corners.map(|(along, across)| at(along, across)),
                r#" fill="white""#,
            );
        }
        "capacitor" => {
            line(svg, &[at(-half, -10.0), at(-half, 10.0)], "");
            line(svg, &[at(half, -10.0), at(half, 10.0)], "");
        }
        "diode" => {
            let corners = [(-half, -7.0), (half, 0.0), (-half, 7.0), (-half, -7.0)];
            line(
                svg,
                &corners.map(|(along, across)| at(along, across)),
                r#" fill="black""#,
            );
            line(svg, &[at(half, -7.0), at(half, 7.0)], "");
        }
        // Closed at rest: the blade touches the far end's stop.
        _ => {
            line(svg, &[at(-half, 0.0), at(half + 3.0, 5.0)], "");
            line(svg, &[at(half, 0.0), at(half, 8.0)], "");
        }
    }
    // Beside an upright part, above a level one.
    if dx.abs() < dy.abs() {
        let (x, y) = at(0.0, 0.0);
        label(svg, x + 14.0, y + 4.5, "start", text);
    } else {
        let (x, y) = at(0.0, 0.0);
        label(svg, x, y - 13.0, "middle", text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_thing_is_drawn() {
        let text = "# a comment\nsize 20 10\nblock 1 1 5 5 A & B\npin 6 2 left PC9\nwire 6 2 9 2 9 4\ndashed 1 8 9 8\n\
                    resistor 9 4 9 8 10 kOhm\ncapacitor 9 4 15 4 10 nF\ndiode 9 4 15 4 D\ncontact 9 4 15 4 STOP\n\
                    ground 9 8\nsupply 9 2 3.3 V\ndot 9 4\nnote 1 9 x < y\n";
        let svg = draw(text).expect("a drawing");
        for part in [
            "A &amp; B",
            "x &lt; y",
            "10 kOhm",
            "60,20 90,20 90,40",
            "stroke-dasharray",
        ] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
        assert_eq!(
            svg.matches("<svg").count() + svg.matches("</svg>").count(),
            2
        );
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, says) in [
            ("", "no `size W H`"),
            ("block 1 1 5 5 A", "comes first"),
            ("size 9 9\nwire 1 2 3", "from place to place"),
            ("size 9 9\ncoil 1 2 3 4 L", "`coil` is no thing"),
            ("size 9 9\npin 1 2 up X", "not `up`"),
            ("size 9 9\nblock 1 1 5 A", "4 numbers are wanted"),
        ] {
            let error = format!("{:#}", draw(text).expect_err("wrong"));
            assert!(error.contains(says), "{error}");
            assert!(
                text.lines().count() < 2 || error.contains("line 2"),
                "{error}"
            );
        }
    }
}
