//! What one session says of itself in `sutura run --format json`. Entry point: [`Measured::read`].

use serde::Serialize;
use serde_json::Value;

/// One session. What its summary does not have is none: a session that failed early has little.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Measured {
    /// Exit code; none if it was killed.
    pub code: Option<i32>,
    /// `ok`, or why it ended.
    pub status: String,
    /// The console's mode at the end.
    pub mode: String,
    /// Console time \[s\].
    pub seconds: Option<f64>,
    /// Times that the force decayed.
    pub decays: Option<f64>,
    /// All that was given up, added up.
    pub overload: Option<f64>,
    /// Largest contact force \[N\].
    pub peak_n: Option<f64>,
    /// Its root of the mean square \[N\].
    pub rms_n: Option<f64>,
    /// Boundaries that needles went through.
    pub punctures: Option<f64>,
    /// The wound's gap at the end over the one at the beginning.
    pub gap_ratio: Option<f64>,
    /// Solves made over those planned.
    pub solves_ratio: Option<f64>,
    /// From a state to the tick that used its contact, median \[us\].
    pub latency_p50_us: Option<f64>,
    /// Largest horizon \[ms\].
    pub horizon_ms: Option<f64>,
    /// The whole solve \[us\].
    pub session_p99_us: Option<f64>,
    pub session_max_us: Option<f64>,
    /// Largest mean of a second \[us\].
    pub session_second_us: Option<f64>,
    /// Steps in which the tissue was touched.
    pub contact_steps: Option<f64>,
    /// How late a thread woke that only sleeps, at most \[us\]: the session's own, or else one beside it.
    pub machine_late_us: f64,
}

/// Sum of all numbers in a value.
fn sum(value: &Value) -> f64 {
    match value {
        Value::Number(number) => number.as_f64().unwrap_or(0.0),
        Value::Array(values) => values.iter().map(sum).sum(),
        Value::Object(values) => values.values().map(sum).sum(),
        _ => 0.0,
    }
}

impl Measured {
    /// Reads what a session left: its exit code, its stdout, the last line of its stderr, and how late a thread beside it
    /// was at most \[us\].
    pub fn read(code: Option<i32>, stdout: &str, stderr: &str, late_us: f64) -> Self {
        let object = stdout
            .lines()
            .rev()
            .find_map(|line| serde_json::from_str::<Value>(line).ok())
            .or_else(|| serde_json::from_str(stdout).ok())
            .unwrap_or_default();
        let number = |path: &str| object.pointer(path).and_then(Value::as_f64);
        let words = |path: &str| object.pointer(path).and_then(Value::as_str);
        let ratio = number("/host_hz_reached").zip(number("/host_hz"));
        let last = stderr.lines().rev().find(|line| !line.trim().is_empty());
        let status = words("/status").or(last).unwrap_or("nothing was said");
        let late = number("/machine_late_us/max").or_else(|| number("/machine_late_us"));
        Self {
            code,
            status: match words("/message") {
                Some(message) => format!("{status}: {message}"),
                None => status.to_owned(),
            },
            mode: words("/mode").unwrap_or_default().to_owned(),
            seconds: number("/seconds"),
            decays: number("/decays"),
            overload: object.get("overload").map(sum),
            peak_n: number("/force_n/peak"),
            rms_n: number("/force_n/rms"),
            punctures: number("/scene/punctures"),
            gap_ratio: number("/scene/gap_ratio"),
            solves_ratio: ratio.map(|(reached, planned)| reached / planned),
            latency_p50_us: number("/latency_us/p50"),
            horizon_ms: number("/horizon_ms/max"),
            session_p99_us: number("/session_us/p99"),
            session_max_us: number("/session_us/max"),
            session_second_us: number("/session_us/second")
                .or_else(|| number("/session_us/second_max")),
            contact_steps: number("/contact_steps"),
            machine_late_us: late.unwrap_or(late_us),
        }
    }

    /// Whether it ended as it should.
    pub fn is_ok(&self) -> bool {
        self.code == Some(0) && self.status == "ok"
    }

    /// Whether the console had given the session up.
    pub fn went_idle(&self) -> bool {
        self.mode == "idle" || self.status.contains("idle")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_summary_is_read_and_what_it_lacks_is_none() {
        let stdout = r#"{"status":"ok","mode":"armed","seconds":5.0,"decays":1,"host_hz":200.0,"host_hz_reached":190.0,
"force_n":{"peak":4.7,"rms":1.5},"scene":{"punctures":4,"gap_ratio":0.2},"overload":{"looks":2,"rate":{"least_hz":0,"steps":1}},
"machine_late_us":{"p99":80,"max":6000}}"#;
        let one = Measured::read(Some(0), stdout, "", 10.0);
        assert!(one.is_ok() && !one.went_idle());
        assert_eq!((one.decays, one.overload), (Some(1.0), Some(3.0)));
        assert_eq!((one.peak_n, one.rms_n), (Some(4.7), Some(1.5)));
        assert_eq!((one.punctures, one.gap_ratio), (Some(4.0), Some(0.2)));
        assert_eq!(one.solves_ratio, Some(0.95));
        assert_eq!((one.session_p99_us, one.horizon_ms), (None, None));
        assert_eq!(one.machine_late_us, 6000.0);
    }

    #[test]
    fn a_failure_says_why() {
        let stdout =
            r#"{"status":"idle: no usable contact for too long","exit_code":1,"mode":"idle"}"#;
        let one = Measured::read(Some(1), stdout, "", 10.0);
        assert!(!one.is_ok() && one.went_idle());
        assert_eq!(one.machine_late_us, 10.0);
        let silent = Measured::read(None, "", "thread 'main' panicked\n\n", 0.0);
        assert_eq!(silent.status, "thread 'main' panicked");
        assert!(!silent.is_ok());
    }
}
