//! `sutura run --series`, `sutura replay --series` and `sutura solve --out FILE.vtu`: files that ParaView opens.

use crate::support::{root, sutura};
use roxmltree::Document;
use std::path::Path;

fn numbers(document: &Document<'_>, name: &str) -> Vec<f64> {
    let arrays = document.descendants();
    let found = arrays
        .filter(|n| n.attribute("Name") == Some(name))
        .find_map(|n| n.text());
    let words = found.unwrap_or_else(|| panic!("no `{name}`"));
    let words = words.split_ascii_whitespace();
    words.map(|word| word.parse().expect("a number")).collect()
}

/// Points of each line of a part, by where it is now.
fn lines(document: &Document<'_>, part: f64) -> Vec<Vec<[f64; 3]>> {
    let points = numbers(document, "points_m");
    let (points, _) = points.as_chunks::<3>();
    let connectivity = numbers(document, "connectivity");
    let mut from = 0;
    let mut found = Vec::new();
    for (end, of) in numbers(document, "offsets")
        .into_iter()
        .zip(numbers(document, "part"))
    {
        if of == part {
            let own = &connectivity[from..end as usize];
            found.push(own.iter().map(|node| points[*node as usize]).collect());
        }
        from = end as usize;
    }
    found
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
    squares.sum::<f64>().sqrt()
}

/// Nodes of the tissue, where they are now.
fn nodes(document: &Document<'_>) -> Vec<[f64; 3]> {
    let (points, displacement) = (
        numbers(document, "points_m"),
        numbers(document, "displacement_m"),
    );
    let at: Vec<f64> = points
        .iter()
        .zip(&displacement)
        .map(|(x, u)| x + u)
        .collect();
    let of_lines: usize = [1.0, 2.0, 3.0]
        .iter()
        .flat_map(|part| lines(document, *part))
        .map(|line| line.len())
        .sum();
    let (at, _) = at.as_chunks::<3>();
    at[..at.len() - of_lines].to_vec()
}

/// Palpation's sphere in a picture: how far the nearest node is from its surface \[m\].
fn nearest_to_the_sphere(path: &Path) -> f64 {
    let text = std::fs::read_to_string(path).expect("a picture");
    let document = Document::parse(&text).expect("well-formed XML");
    let outline = lines(&document, 3.0);
    let ring = outline.last().expect("a ring around the sphere");
    let (first, half) = (&ring[0], &ring[ring.len() / 2]);
    let centre: [f64; 3] = std::array::from_fn(|axis| 0.5 * (first[axis] + half[axis]));
    let radius = 0.5 * distance(first, half);
    let nodes = nodes(&document);
    let nearest = nodes.iter().map(|at| distance(at, &centre));
    nearest.fold(f64::INFINITY, f64::min) - radius
}

#[test]
fn a_session_becomes_a_row_of_pictures() {
    let directory = tempfile::tempdir().expect("a directory");
    let pictures = directory.path().join("pictures");
    let run = [
        "run",
        "scenes/palpation.toml",
        "--lockstep",
        "--seconds",
        "1.5",
        "--format",
        "json",
        "--series-hz",
        "10",
        "--series",
    ];
    let folder = pictures.to_string_lossy();
    let ran = sutura(&[run.as_slice(), &[&folder]].concat());
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    assert!(ran.stderr.contains("session.pvd"), "{}", ran.stderr);
    let list = std::fs::read_to_string(pictures.join("session.pvd")).expect("a list");
    let document = Document::parse(&list).expect("well-formed XML");
    let sets: Vec<_> = document
        .descendants()
        .filter(|n| n.has_tag_name("DataSet"))
        .collect();
    assert!((14..=16).contains(&sets.len()), "{} pictures", sets.len());
    let mut last_s = -1.0;
    for (number, set) in sets.iter().enumerate() {
        let time_s: f64 = set
            .attribute("timestep")
            .expect("a time")
            .parse()
            .expect("a number");
        // Solves come every 10 ms.
        let late_s = time_s - 0.1 * number as f64;
        assert!(
            time_s > last_s && (-1e-9..0.011).contains(&late_s),
            "{time_s}"
        );
        last_s = time_s;
    }
    let files: Vec<_> = sets
        .iter()
        .filter_map(|set| set.attribute("file"))
        .collect();
    let gaps = files
        .iter()
        .map(|file| nearest_to_the_sphere(&pictures.join(file)));
    let gaps: Vec<_> = gaps.collect();
    // It comes from above, touches, and is lifted again; it is never inside.
    let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(least.abs() < 1e-9, "{gaps:?}");
    assert!(gaps[0] > 1e-3 && gaps.iter().filter(|gap| **gap < 1e-9).count() > 5);

    // The same from its recording; and what is in the way stays.
    let recording = pictures.join("session.mcap");
    let again = directory.path().join("again");
    let replay = |to: &Path| {
        let (from, to) = (recording.to_string_lossy(), to.to_string_lossy());
        sutura(&["replay", &from, "--series-hz", "10", "--series", &to])
    };
    let ran = replay(&again);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    for file in files {
        let [one, other] = [&pictures, &again].map(|dir| std::fs::read(dir.join(file)));
        assert!(one.expect("a file") == other.expect("a file"), "{file}");
    }
    let ran = replay(&again);
    assert_eq!(ran.code, 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("not empty"), "{}", ran.stderr);
}

/// A needle that carries its thread through two slabs: both are in the file, where they belong.
#[test]
fn a_solve_shows_needle_and_thread() {
    let directory = tempfile::tempdir().expect("a directory");
    let out = directory.path().join("sewn.vtu");
    let scene = root().join("scenes/wound-slabs.toml");
    let (scene, to) = (scene.to_string_lossy(), out.to_string_lossy());
    let ran = sutura(&["solve", &scene, "--at", "9.5", "--out", &to]);
    assert_eq!(ran.code, 0, "{}", ran.stderr);
    let text = std::fs::read_to_string(&out).expect("a file");
    let document = Document::parse(&text).expect("well-formed XML");
    let (needles, threads) = (lines(&document, 1.0), lines(&document, 2.0));
    assert_eq!((needles.len(), threads.len()), (1, 1));
    // Its head is fastened to the needle's end.
    let head = threads[0].last().expect("points");
    assert!(distance(head, &needles[0][0]) < 1e-9, "{head:?}");
    assert!(threads[0].len() > 3, "{} points", threads[0].len());
    let fixed = numbers(&document, "fixed");
    assert!(fixed.contains(&1.0) && fixed.contains(&0.0));
    let radius_m = numbers(&document, "radius_m");
    assert!(radius_m.iter().any(|radius| *radius > 0.0));
    let mut von_mises = numbers(&document, "von_mises_pa");
    von_mises.retain(|stress| *stress > 0.0);
    assert!(!von_mises.is_empty());
}
