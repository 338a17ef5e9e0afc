//! How much room words take, and where they are broken.

/// Advances of the printable ASCII characters, 1/1000 em: of DejaVu Sans, the widest of the fonts that `sans-serif` is
/// likely to be. What fits with it fits with Arial, Helvetica or Liberation Sans.
const ADVANCES: [u16; 95] = [
    318, 401, 460, 838, 636, 950, 780, 275, 390, 390, 500, 838, 318, 361, 318, 337, 636, 636, 636,
    636, 636, 636, 636, 636, 636, 636, 337, 337, 838, 838, 838, 531, 1000, 684, 686, 698, 770, 632,
    575, 775, 752, 295, 295, 656, 557, 863, 748, 787, 603, 787, 695, 635, 611, 732, 684, 989, 685,
    611, 685, 390, 337, 390, 838, 500, 500, 613, 635, 550, 635, 615, 352, 635, 634, 278, 278, 579,
    278, 974, 634, 612, 635, 635, 411, 521, 392, 634, 592, 818, 592, 592, 525, 636, 337, 636, 838,
];

/// Width of words \[px\] in letters of a size \[px\].
pub fn width(words: &str, size: f64) -> f64 {
    let advance = |c: char| match c {
        '\u{2212}' | '\u{d7}' => 838,
        _ => {
            let printable = u32::from(c).checked_sub(32).map(|index| index as usize);
            // Others are at most about an em wide.
            printable
                .and_then(|index| ADVANCES.get(index))
                .map_or(1000, |advance| u32::from(*advance))
        }
    };
    1e-3 * size * f64::from(words.chars().map(advance).sum::<u32>())
}

/// Broken into at most so many lines that fit into a width; what does not fit ends in an ellipsis.
pub fn wrapped(words: &str, size: f64, room: f64, most: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(&format!("{line} {word}"), size) <= room => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    let is_cut = lines.len() > most;
    lines.truncate(most);
    let last = lines.len().saturating_sub(1);
    for (index, line) in lines.iter_mut().enumerate() {
        let has_more = is_cut && index == last;
        if has_more || width(line, size) > room {
            *line = shortened(line, size, room);
        }
    }
    lines
}

fn shortened(line: &str, size: f64, room: f64) -> String {
    let mut rest = line.to_owned();
    while !rest.is_empty() && width(&rest, size) + size > room {
        rest.pop();
    }
    format!("{}\u{2026}", rest.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_fit_and_nothing_is_lost_that_fits() {
        let words = "largest error against quadratic cells";
        let lines = wrapped(words, 12.0, 120.0, 9);
        assert!(lines.len() > 1 && lines.iter().all(|line| width(line, 12.0) <= 120.0));
        assert_eq!(lines.join(" "), words);
    }

    #[test]
    fn what_does_not_fit_says_so() {
        for (words, most) in [
            ("a-single-word-that-is-far-too-long", 3),
            ("one two three four", 1),
        ] {
            let lines = wrapped(words, 12.0, 80.0, most);
            assert!(
                lines.iter().any(|line| line.ends_with('\u{2026}')),
                "{lines:?}"
            );
            assert!(
                lines.iter().all(|line| width(line, 12.0) <= 80.0),
                "{lines:?}"
            );
        }
    }
}
