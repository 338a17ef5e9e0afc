//! The figures on a screen of 80 x 24 and more.
//!
//! Entry point: [`draw`].

use super::figures::{Figures, Spread};
use super::keys::Keys;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize as _};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Borders, Clear, Paragraph, Sparkline, Wrap};
use std::time::Instant;

/// The least that all of it is seen on.
pub const LEAST: (u16, u16) = (80, 24);
/// Width of the names of figures.
const NAME: usize = 11;
/// A figure that is not said.
const NONE: &str = "–";

/// How it is looked at.
pub struct Look<'a> {
    /// When.
    pub now: Instant,
    /// Keys so far.
    pub keys: &'a Keys,
    /// What `q` does.
    pub quits: &'static str,
}

/// Draws all of it.
pub fn draw(frame: &mut Frame<'_>, figures: &Figures, look: &Look<'_>) {
    let area = frame.area();
    if (area.width, area.height) < LEAST && (area.width < LEAST.0 || area.height < LEAST.1) {
        small(frame, figures, area);
        return;
    }
    // What is high gives its height to the force and to what happens.
    let more = area.height - LEAST.1;
    let force = 5 + more / 4;
    let [title, mode, faults, force, middle, events, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(1),
        Constraint::Length(2),
        Constraint::Length(force),
        Constraint::Length(11),
        Constraint::Min(3),
        Constraint::Length(1),
    ])
    .areas(area);
    frame.render_widget(title_line(figures), title);
    frame.render_widget(mode_line(figures, look), mode);
    frame.render_widget(fault_lines(figures), faults);
    // A figure whose source has gone is crossed out.
    let is_old = figures.silent_for(look.now).is_some();
    let style = if is_old {
        Style::new().add_modifier(Modifier::CROSSED_OUT | Modifier::DIM)
    } else {
        Style::new()
    };
    draw_force(frame, figures, style, force);
    let [left, right] =
        Layout::horizontal([Constraint::Percentage(56), Constraint::Fill(1)]).areas(middle);
    let times = section(" latency, age, link ");
    frame.render_widget(
        Paragraph::new(left_lines(figures))
            .style(style)
            .block(times),
        left,
    );
    draw_step(frame, figures, style, right);
    draw_events(frame, figures, events);
    frame.render_widget(key_line(figures, look), keys);
    if look.keys.helps {
        help(frame, look.quits, area);
    }
}

fn section(title: &str) -> Block<'_> {
    Block::new().borders(Borders::TOP).title(title.bold())
}

/// What there is room for on a small screen.
fn small(frame: &mut Frame<'_>, figures: &Figures, area: Rect) {
    let words = format!(
        "{}\n{}\n{} x {} is too small, {} x {} shows all",
        figures.mode().unwrap_or(NONE).to_uppercase(),
        figures
            .force_n()
            .map_or(NONE.to_owned(), |force_n| format!("{force_n:.3} N")),
        area.width,
        area.height,
        LEAST.0,
        LEAST.1,
    );
    frame.render_widget(Paragraph::new(words).wrap(Wrap { trim: true }), area);
}

fn title_line(figures: &Figures) -> Line<'static> {
    let word = |key: &str| figures.word(key).unwrap_or(NONE).to_owned();
    let role = if figures.controls() {
        "controls"
    } else {
        "watches"
    };
    Line::from(vec![
        " sutura ".bold().reversed(),
        format!(
            "  {}: {}, {} on {} ({}), {}  {role}",
            word("scene"),
            word("tissue"),
            word("rendering"),
            word("console"),
            word("device"),
            word("pace"),
        )
        .into(),
    ])
}

fn mode_line(figures: &Figures, look: &Look<'_>) -> Line<'static> {
    if figures.is_recording() {
        let words = " the session is over; its recording is on the page";
        return Line::from(words.bold());
    }
    let mode = figures.mode();
    let colour = match mode {
        Some("armed") => Color::Green,
        Some("decaying") => Color::Yellow,
        Some("fault") => Color::Red,
        _ => Color::Gray,
    };
    let time = figures
        .number(&["time_s"])
        .map_or(NONE.to_owned(), |s| format!("{s:.1} s"));
    let tick = figures
        .number(&["tick"])
        .map_or(NONE.to_owned(), |tick| format!("{tick:.0}"));
    let mut spans = vec![
        format!(" {} ", mode.unwrap_or(NONE).to_uppercase())
            .bold()
            .fg(Color::Black)
            .bg(colour),
        format!("  {time}  tick {tick}").into(),
    ];
    if figures.is_paused() {
        spans.push("  paused".bold().yellow());
    }
    if let Some(silent) = figures.silent_for(look.now) {
        let words = format!("  no word for {} s", silent.as_secs());
        spans.push(words.bold().red());
    }
    Line::from(spans)
}

/// Faults with what to do, or why a command was not done.
fn fault_lines(figures: &Figures) -> Paragraph<'static> {
    let faults = figures.faults();
    let more = faults.len().saturating_sub(1);
    let text = match (faults.into_iter().next(), figures.refused()) {
        (Some((name, message, help)), _) => {
            let others = if more > 0 {
                format!(" (and {more} more)")
            } else {
                String::new()
            };
            format!(" {name}: {message}: {help}{others}").bold().red()
        }
        (None, Some(refused)) => format!(" {refused}").yellow(),
        (None, None) => "".into(),
    };
    Paragraph::new(Line::from(text)).wrap(Wrap { trim: false })
}

fn draw_force(frame: &mut Frame<'_>, figures: &Figures, style: Style, area: Rect) {
    let block = section(" force ");
    let inside = block.inner(area);
    frame.render_widget(block, area);
    let [value, line] = Layout::vertical([Constraint::Length(1), Constraint::Min(1)]).areas(inside);
    let most_n = figures.most_n();
    let force_n = figures.force_n();
    let said = force_n.map_or(NONE.to_owned(), |force_n| format!("{force_n:.3}"));
    let scale = format!(" of {most_n:.3} N in 30 s");
    let width = usize::from(value.width).saturating_sub(12 + scale.len());
    let part = force_n.map_or(0.0, |force_n| force_n / most_n.max(1e-6));
    let words = Line::from(vec![
        format!(" {said:>8} N ").bold(),
        bar(part, width).fg(Color::Cyan),
        scale.into(),
    ]);
    frame.render_widget(words.style(style), value);
    let milli = figures.force_line(usize::from(line.width));
    let milli = milli
        .into_iter()
        .map(|force_n| force_n.map(|force_n| (1e3 * force_n) as u64));
    let chart = Sparkline::default()
        .data(milli.collect::<Vec<_>>())
        .max(((1e3 * most_n) as u64).max(1))
        .style(style.fg(Color::Cyan));
    frame.render_widget(chart, line);
}

/// Bar of a part of a width, in eighths of a cell.
fn bar(part: f64, width: usize) -> Span<'static> {
    const EIGHTHS: [&str; 8] = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"];
    let eighths = (part.clamp(0.0, 1.0) * 8.0 * width as f64).round() as usize;
    let mut text = "█".repeat(eighths / 8);
    text.push_str(EIGHTHS.get(eighths % 8).copied().unwrap_or_default());
    Span::raw(format!("{text:width$}"))
}

fn name(name: &str) -> Span<'static> {
    Span::raw(format!(" {name:NAME$}"))
}

/// Percentiles in the unit that suits them, now and of the session.
fn spreads([now, all]: [Option<Spread>; 2]) -> String {
    let said = |spread: Option<Spread>| match spread {
        Some([p50, p99]) => format!("{:5.1} {:5.1}", 1e-3 * p50, 1e-3 * p99),
        None => format!("{NONE:>5} {NONE:>5}"),
    };
    format!("{}  {}", said(now), said(all))
}

fn left_lines(figures: &Figures) -> Vec<Line<'static>> {
    let horizon = figures.horizon_us();
    let number = |keys: &[&str], decimals: usize| {
        let value = figures.number(keys);
        value.map_or(NONE.to_owned(), |value| format!("{value:.decimals$}"))
    };
    let rate = |key: &str| {
        let value = figures.number(&["bytes_per_s", key]);
        value.map_or(NONE.to_owned(), |value| format!("{:.1}", 1e-3 * value))
    };
    let time = |label: &str, key: &str| {
        let all = figures.spread(key);
        let newest = all.iter().flatten().next().map(|[_, p99]| *p99);
        // Beyond the horizon there is no force any more.
        let beyond = newest.zip(horizon).is_some_and(|(us, most)| us > most);
        let words = Span::raw(spreads(all));
        let words = if beyond { words.bold().red() } else { words };
        let part = newest.zip(horizon).map_or(0.0, |(us, most)| us / most);
        let colour = if beyond { Color::Red } else { Color::Cyan };
        Line::from(vec![
            name(label),
            words,
            " ".into(),
            bar(part, 6).fg(colour),
        ])
    };
    let horizon = horizon.map_or(NONE.to_owned(), |us| format!("{:.0} ms", 1e-3 * us));
    let trips = figures.spread("rtt_us").into_iter().flatten().next();
    let trips = trips.map_or(NONE.to_owned(), |[p50, p99]| {
        format!("p50 {:.1}  p99 {:.1} ms", 1e-3 * p50, 1e-3 * p99)
    });
    let solves = figures.statuses();
    let solves = if solves.is_empty() {
        NONE.to_owned()
    } else {
        let each = solves.iter().map(|(word, count)| format!("{word} {count}"));
        each.collect::<Vec<_>>().join("  ")
    };
    let cut = figures.limited().into_iter();
    let cut: String = cut
        .map(|(limit, count)| format!(", {count} cut by {limit}"))
        .collect();
    let wanted = figures
        .wanted_hz()
        .map_or(NONE.to_owned(), |hz| format!("{hz:.0}"));
    let line = |label: &str, text: String| Line::from(vec![name(label), text.into()]);
    vec![
        Line::from(format!(
            " {:NAME$}{:>5} {:>5}  {:>5} {:>5} of {horizon}",
            "ms", "p50", "p99", "all", "p99"
        ))
        .dim(),
        time("latency", "latency_us"),
        time("age", "age_us"),
        line(
            "energy",
            format!(
                "{} J, least {} J",
                number(&["energy_j"], 5),
                number(&["energy_min_j"], 6)
            ),
        ),
        line(
            "link",
            format!("{} kB/s down, {} up", rate("down"), rate("up")),
        ),
        line("round trip", trips),
        line(
            "frames",
            format!(
                "{} lost, {} rejected, {} superseded",
                number(&["frames", "lost"], 0),
                number(&["frames", "rejected"], 0),
                number(&["frames", "superseded"], 0)
            ),
        ),
        line(
            "ticks",
            format!(
                "{} late, {} overruns{cut}",
                number(&["ticks_late"], 0),
                number(&["tick_overruns"], 0)
            ),
        ),
        line("solves", solves),
        line(
            "speed",
            format!(
                "{} x real time, {} of {wanted} Hz",
                number(&["speed"], 2),
                number(&["host_hz"], 1)
            ),
        ),
    ]
}

fn draw_step(frame: &mut Frame<'_>, figures: &Figures, style: Style, area: Rect) {
    let block = section(" step by stage, on average ");
    let inside = block.inner(area);
    let stages = figures.stages();
    let sum_us: f64 = stages.iter().filter_map(|(_, us)| *us).sum();
    let width = usize::from(inside.width).saturating_sub(NAME + 12);
    let mut lines: Vec<Line<'_>> = stages
        .iter()
        .map(|(stage, us)| {
            let part = us.map_or(0.0, |us| us / sum_us.max(1e-9));
            let said = us.map_or(NONE.to_owned(), |us| format!("{us:.0}"));
            let is_rest = stage == "rest";
            let colour = if is_rest { Color::Magenta } else { Color::Blue };
            Line::from(vec![
                name(stage),
                format!("{said:>7} us ").into(),
                bar(part, width).fg(colour),
            ])
        })
        .collect();
    let step = match figures.spread("step_us") {
        [Some([p50, p99]), _] => format!("p50 {p50:.0}  p99 {p99:.0} us"),
        [None, _] => NONE.to_owned(),
    };
    lines.push(Line::from(vec![name("step"), step.bold()]));
    frame.render_widget(Paragraph::new(lines).style(style).block(block), area);
}

fn draw_events(frame: &mut Frame<'_>, figures: &Figures, area: Rect) {
    let block = section(" what happened ");
    let room = usize::from(block.inner(area).height);
    let mut newest: Vec<Line<'_>> = figures
        .events()
        .rev()
        .take(room)
        .map(|words| Line::from(format!(" {words}")))
        .collect();
    newest.reverse();
    frame.render_widget(Paragraph::new(newest).block(block), area);
}

fn key_line(figures: &Figures, look: &Look<'_>) -> Line<'static> {
    if look.keys.is_arming(look.now) {
        return Line::from(
            " a once more arms the console; any other key does not"
                .bold()
                .yellow(),
        );
    }
    let pause = if figures.is_paused() {
        "go on"
    } else {
        "pause"
    };
    let keys = [
        ("s", "safe stop"),
        ("a a", "arm"),
        ("c", "clear"),
        ("p", pause),
        ("t", "controls"),
        ("q", "quit"),
        ("?", "help"),
    ];
    let each = keys.into_iter().flat_map(|(key, does)| {
        [
            format!(" {key} ").bold().reversed(),
            format!(" {does} ").into(),
        ]
    });
    Line::from(each.collect::<Vec<_>>())
}

fn help(frame: &mut Frame<'_>, quits: &str, area: Rect) {
    let words = format!(
        "s    safe stop: disarms at once; anybody may\n\
         a    arms the console, pressed twice within 2 s\n\
         c    clears latched faults, once their cause is removed\n\
         p    pauses a scene that is steered, and lets it go on\n\
         t    takes the controls from whoever has them\n\
         q    {quits}; Ctrl-C, too\n\
         \n\
         – is a figure that this session does not have: a session in\n\
         lockstep has no link and no times. Crossed out is what was\n\
         said more than 2 s ago. The bars of latency and age are\n\
         parts of the horizon, after which the console lets go.\n\
         \n\
         Safe stop is software. It is no emergency stop."
    );
    let [_, middle, _] = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(15),
        Constraint::Fill(1),
    ])
    .areas(area);
    let [_, middle, _] = Layout::horizontal([
        Constraint::Fill(1),
        Constraint::Length(66),
        Constraint::Fill(1),
    ])
    .areas(middle);
    frame.render_widget(Clear, middle);
    let block = Block::bordered().title(" keys; any of them goes back ".bold());
    frame.render_widget(Paragraph::new(words).block(block), middle);
}

#[cfg(test)]
mod tests {
    use super::super::figures::example;
    use super::super::source::Message;
    use super::super::terminal::Pressed;
    use super::*;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use serde_json::json;
    use std::time::Duration;

    /// What is on a screen, and how each cell of it is styled.
    fn screen(
        (width, height): (u16, u16),
        figures: &Figures,
        keys: &Keys,
        now: Instant,
    ) -> (Vec<String>, Vec<Modifier>) {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a terminal");
        let look = Look {
            now,
            keys,
            quits: "q leaves",
        };
        terminal
            .draw(|frame| draw(frame, figures, &look))
            .expect("drawn");
        let buffer = terminal.backend().buffer();
        let rows = buffer.content.chunks(usize::from(width));
        let rows = rows.map(|row| row.iter().map(|cell| cell.symbol()).collect::<String>());
        let styles = buffer.content.iter().map(|cell| cell.modifier);
        (rows.collect(), styles.collect())
    }

    /// Every figure, whole, at the least size and at a large one.
    #[test]
    fn all_figures_are_on_the_screen() {
        let now = Instant::now();
        let figures = example(now);
        for size in [LEAST, (200, 60)] {
            let (rows, _) = screen(size, &figures, &Keys::default(), now);
            let has = |words: &str| {
                let found = rows.iter().any(|row| row.contains(words));
                assert!(found, "{words} at {size:?}:\n{}", rows.join("\n"));
            };
            let figures = [
                " ARMED ",
                "12.5 s  tick 12500",
                "palpation: linear, rows on /dev/ttyACM0 (delta-3), real-time  controls",
                "of 1.500 N in 30 s",
                "latency      3.2   4.8    3.2   9.6",
                "age          5.1   7.9    5.1  15.8",
                "of 20 ms",
                "energy     0.00123 J, least -0.000004 J",
                "link       44.5 kB/s down, 51.2 up",
                "round trip p50 0.9  p99 1.4 ms",
                "frames     1 lost, 0 rejected, 12 superseded",
                "ticks      3 late, 0 overruns",
                "solves     ok 3093  waiting 7",
                "speed      1.00 x real time, 249.8 of 250 Hz",
                "approach         0 us",
                "solve          480 us",
                "look           120 us",
                "rest            22 us",
                "step       p50 810  p99 1240 us",
                "0.00 s  the console is armed",
                " q  quit  ?  help ",
            ];
            figures.iter().for_each(|words| has(words));
            assert_eq!(rows.len(), usize::from(size.1));
        }
    }

    #[test]
    fn faults_come_with_their_fix() {
        let now = Instant::now();
        let mut figures = Figures::new(now);
        let hello = json!({
            "kind": "hello", "session": 1, "mode": "fault", "faults": ["e_stop", "overrun"],
            "fixes": {"e_stop": {"message": "the emergency stop is pressed, or was", "help": "release it, and clear the fault"}},
        });
        figures.hear(&Message::Text(hello), now);
        let (rows, _) = screen(LEAST, &figures, &Keys::default(), now);
        assert!(rows[1].contains(" FAULT "), "{rows:#?}");
        let words =
            "e_stop: the emergency stop is pressed, or was: release it, and clear the fault";
        let said = rows[2..4].concat();
        let said = said.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            said.contains(words) && said.contains("and 1 more"),
            "{said}"
        );
    }

    /// Nothing is invented: without figures there are dashes, and old ones are crossed out.
    #[test]
    fn what_is_missing_or_old_is_shown_as_such() {
        let now = Instant::now();
        let (rows, _) = screen(LEAST, &Figures::new(now), &Keys::default(), now);
        let all = rows.join("\n");
        for words in [
            " – N",
            "link       – kB/s down, – up",
            "ticks      – late, – overruns",
            "rest             – us",
        ] {
            assert!(all.contains(words), "{words}:\n{all}");
        }
        let figures = example(now);
        let crossed = |at| {
            let (rows, styles) = screen(LEAST, &figures, &Keys::default(), at);
            let count = styles
                .iter()
                .filter(|style| style.contains(Modifier::CROSSED_OUT));
            (count.count() > 400, rows[1].contains("no word for 3 s"))
        };
        assert_eq!(crossed(now), (false, false));
        assert_eq!(crossed(now + Duration::from_secs(3)), (true, true));
    }

    #[test]
    fn keys_explain_themselves() {
        let now = Instant::now();
        let figures = example(now);
        let mut keys = Keys::default();
        keys.press(Pressed::Key('a'), &figures, now);
        let (rows, _) = screen(LEAST, &figures, &keys, now);
        assert!(rows[23].contains("a once more arms"), "{}", rows[23]);
        keys.press(Pressed::Key('?'), &figures, now);
        let (rows, _) = screen(LEAST, &figures, &keys, now);
        let all = rows.join("\n");
        assert!(all.contains("It is no emergency stop") && all.contains("takes the controls"));
    }

    /// No size makes it panic, and the mode is seen where there is any room.
    #[test]
    fn any_size_is_drawn() {
        let now = Instant::now();
        let figures = example(now);
        for size in [
            (1, 1),
            (10, 3),
            (79, 24),
            (80, 23),
            (80, 24),
            (81, 25),
            (400, 100),
        ] {
            let (rows, _) = screen(size, &figures, &Keys::default(), now);
            let is_seen = size.0 < 10 || rows.concat().contains("ARMED");
            assert!(is_seen, "{size:?}");
        }
    }
}
