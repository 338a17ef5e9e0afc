//! Why a command ended without success, and the exit code that scripts see.
//!
//! Entry point: [`Failure`]. Every command returns one; `main` renders it once and exits with its
//! cause's code. The codes are a contract: add, never renumber.

use miette::{Diagnostic, GraphicalReportHandler, GraphicalTheme, Report};
use std::fmt;
use std::io::IsTerminal;
use sutura_host::text::{harmless, one_line};

/// What went wrong, as an exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Cause {
    /// The input was good, but the work could not be finished: no convergence, a full disk.
    Failed = 1,
    /// Bad usage or bad input: the user can change an argument or a file.
    BadInput = 2,
    /// No console: no such port, or nothing answers on it; no emulator.
    NoConsole = 3,
    /// The peer speaks another protocol version or other message schemas.
    Protocol = 4,
    /// The console is in a latched fault.
    Fault = 5,
    /// A replay took another course than its recording.
    Diverged = 6,
    /// A budget that the user stated was missed.
    Budget = 7,
    /// A session whose forces cannot be trusted.
    NotRendered = 8,
    /// A recording that could not be run again.
    NotReplayed = 9,
    /// Ctrl-C or a `kill` before a table was whole, or a second one: as shells have it.
    Interrupted = 130,
}

impl Cause {
    /// In the order of their codes.
    pub const ALL: [Cause; 10] = [
        Cause::Failed,
        Cause::BadInput,
        Cause::NoConsole,
        Cause::Protocol,
        Cause::Fault,
        Cause::Diverged,
        Cause::Budget,
        Cause::NotRendered,
        Cause::NotReplayed,
        Cause::Interrupted,
    ];

    /// What it means, in the words of the book.
    pub fn meaning(self) -> &'static str {
        match self {
            Cause::Failed => "the input was good, but the work could not be finished",
            Cause::BadInput => {
                "bad usage or bad input: an argument, a file, something in a file; a recording by another console code; \
                 a console with motors that is another device than the scene's"
            }
            Cause::NoConsole => {
                "no such port, nothing answers on it or it sends no state that can be used, no emulator"
            }
            Cause::Protocol => {
                "the console speaks another protocol version or other message schemas, or all that it sends is refused"
            }
            Cause::Fault => "the console is in a latched fault",
            Cause::Diverged => "a replay took another course than its recording",
            Cause::Budget => "a budget that you stated was missed",
            Cause::NotRendered => {
                "a session whose forces cannot be trusted: steps found a force and none was rendered, or more than a fifth of \
                 the steps in contact were withheld, not balanced, or behind the hand by more than they touched, once those \
                 are a quarter of a second's; a tool was inside the tissue; parts that may touch are in each other, in a session or at rest; a force was \
                 felt and no step found a contact; the \
                 tool touched and the largest force is below 5 mN"
            }
            Cause::NotReplayed => {
                "a recording of which the ticks or the solves could not be run again, since it begins in the middle of a session or \
                 lacks their beginning; what needs no past was compared, and is as recorded"
            }
            Cause::Interrupted => {
                "by Ctrl-C or `kill` before a table was whole: it has what there was by then; of other commands one before a console's first state, \
                 before a recording that is shown had been run again, a picture was taken or a series drawn, or a second Ctrl-C"
            }
        }
    }

    /// The exit code.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Stable word for `status` in JSON output.
    pub fn word(self) -> &'static str {
        match self {
            Cause::Failed => "failed",
            Cause::BadInput => "bad-input",
            Cause::NoConsole => "no-console",
            Cause::Protocol => "protocol-mismatch",
            Cause::Fault => "console-fault",
            Cause::Diverged => "diverged",
            Cause::Budget => "budget-missed",
            Cause::NotRendered => "not-rendered",
            Cause::NotReplayed => "not-replayed",
            Cause::Interrupted => "interrupted",
        }
    }
}

/// A command's end without success: the cause and what to tell the user.
#[derive(Debug)]
pub struct Failure {
    /// Decides the exit code.
    pub cause: Cause,
    /// Rendered on stderr, with source and help where the diagnostic has them.
    pub report: Report,
    /// Whether stdout already has the command's result, which then says the failure too.
    pub summarised: bool,
}

impl Failure {
    /// A failure from any diagnostic.
    pub fn new(cause: Cause, diagnostic: impl Diagnostic + Send + Sync + 'static) -> Failure {
        Failure {
            cause,
            report: Report::new(diagnostic),
            summarised: false,
        }
    }

    /// The same failure, after the command has printed its result.
    pub fn after_summary(self) -> Failure {
        Failure {
            summarised: true,
            ..self
        }
    }

    /// The message with the file and the place that it is about, where there is one, and the next step.
    pub fn in_words(&self) -> [String; 2] {
        let label = self.report.labels().and_then(|mut labels| labels.next());
        let source = self.report.source_code().zip(label);
        let place = source.and_then(|(source, label)| {
            let found = source.read_span(label.inner(), 0, 0).ok()?;
            let (line, column) = (found.line() + 1, found.column() + 1);
            let name = found.name();
            Some(match name {
                Some(name) => format!("{name}, line {line}, column {column}: "),
                None => format!("line {line}, column {column}: "),
            })
        });
        let message = format!("{}{}", place.unwrap_or_default(), self.report);
        let help = self.report.help().map(|help| help.to_string());
        let help = help.unwrap_or_else(|| match self.cause {
            Cause::BadInput => "mend the scene; `sutura scene check` shows the place".to_owned(),
            _ => "`sutura doctor` says what this machine can do".to_owned(),
        });
        [message, help]
    }

    /// A failure from a sentence and what the user can do about it.
    pub fn say(cause: Cause, message: impl Into<String>, help: impl Into<String>) -> Failure {
        Failure::new(
            cause,
            Said {
                message: message.into(),
                help: help.into(),
            },
        )
    }
}

/// Shows a diagnostic on stderr.
pub fn render(report: &Report) {
    // Messages say what they come from themselves: a chain of causes would say it twice.
    let rendered = |handler: GraphicalReportHandler| {
        let handler = handler.without_cause_chain();
        let mut text = String::new();
        match handler.render_report(&mut text, &OneLine(report.as_ref())) {
            Ok(()) => text,
            Err(_) => format!("{report:?}\n"),
        }
    };
    // Off a terminal: no colours, and no wrapping, so that a message can be searched for.
    let plain = GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor());
    let plain = rendered(plain.with_wrap_lines(false));
    let harmless = harmless(&plain);
    let text = match std::io::stderr().is_terminal() && harmless == plain {
        true => rendered(GraphicalReportHandler::new()),
        false => harmless,
    };
    // Whoever reads may have closed the pipe.
    let _ = std::io::Write::write_all(&mut std::io::stderr(), text.as_bytes());
}

/// Diagnostic whose message is one line, whatever names are in it.
#[derive(Debug)]
struct OneLine<'a>(&'a dyn Diagnostic);

impl fmt::Display for OneLine<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.0.to_string();
        match text.contains('\n') {
            true => f.write_str(&one_line(&text)),
            false => f.write_str(&text),
        }
    }
}

impl std::error::Error for OneLine<'_> {}

impl Diagnostic for OneLine<'_> {
    fn code<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.0.code()
    }

    fn severity(&self) -> Option<miette::Severity> {
        self.0.severity()
    }

    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.0.help()
    }

    fn url<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        self.0.url()
    }

    fn source_code(&self) -> Option<&dyn miette::SourceCode> {
        self.0.source_code()
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = miette::LabeledSpan> + '_>> {
        self.0.labels()
    }
}

/// A failure that has no type of its own.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{message}")]
#[diagnostic(help("{help}"))]
struct Said {
    message: String,
    help: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Scripts depend on these numbers.
    #[test]
    fn exit_codes_are_pinned() {
        let pinned = [
            (Cause::Failed, 1),
            (Cause::BadInput, 2),
            (Cause::NoConsole, 3),
            (Cause::Protocol, 4),
            (Cause::Fault, 5),
            (Cause::Diverged, 6),
            (Cause::Budget, 7),
            (Cause::NotRendered, 8),
            (Cause::NotReplayed, 9),
            (Cause::Interrupted, 130),
        ];
        for (cause, code) in pinned {
            assert_eq!(cause.code(), code, "{cause:?}");
        }
        assert_eq!(pinned.map(|(cause, _)| cause), Cause::ALL);
    }
}
