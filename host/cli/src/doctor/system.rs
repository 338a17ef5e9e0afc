//! What this PC does to a console's line and to the threads at its end, read from /dev, /proc and /sys.
//!
//! Entry point: [`System::checks`]. Everything is read below a root folder, so that tests can bring their own.

use super::Check;
use std::fs;
use std::path::{Path, PathBuf};
use sutura_host::scheduling::Role;

/// Longest time for which a bridge may hold bytes back \[ms\]: a tick.
const LATENCY_MS: u32 = 1;
/// Lets whoever sits at the machine open every console, and keeps ModemManager off it.
const UDEV: &str = r#"echo 'SUBSYSTEM=="tty", ATTRS{idVendor}=="16c0", ATTRS{idProduct}=="27dd", TAG+="uaccess", ENV{ID_MM_DEVICE_IGNORE}="1"' | sudo tee /etc/udev/rules.d/70-sutura.rules && sudo udevadm control --reload && sudo udevadm trigger"#;
/// Bit of CAP_SYS_NICE, with which every scheduling class is allowed.
const CAP_SYS_NICE: u32 = 23;

/// Bit of CAP_IPC_LOCK, with which all memory may be locked.
const CAP_IPC_LOCK: u32 = 14;
/// Lets this user's sessions go before ordinary programs and stay in memory.
const PERMIT: &str = r#"printf '%s - rtprio 20\n%s - memlock unlimited\n' "$USER" "$USER" | sudo tee /etc/security/limits.d/70-sutura.conf, then log in again (or, for one program: sudo setcap cap_sys_nice,cap_ipc_lock+ep "$(command -v sutura)")"#;

/// What a process may have at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Limit {
    /// As much as there is.
    None,
    /// So much.
    At(u64),
}

/// A machine, as its file systems show it.
#[derive(Debug)]
pub struct System {
    root: PathBuf,
}

impl System {
    /// The machine whose files are below `root`; `/` is this one.
    pub fn at(root: &Path) -> Self {
        System {
            root: root.to_owned(),
        }
    }

    /// All checks, in the order in which they are best looked at.
    pub fn checks(&self) -> Vec<Check> {
        vec![
            self.ports(),
            self.latency_timers(),
            self.modem_manager(),
            self.real_time(),
            self.locked_memory(),
            self.preemption(),
            self.governor(),
        ]
    }

    fn read(&self, path: &str) -> Option<String> {
        fs::read_to_string(self.root.join(path)).ok()
    }

    /// Names in a folder, sorted; none if there is no such folder.
    fn names(&self, folder: &str) -> Vec<String> {
        let entries = fs::read_dir(self.root.join(folder));
        let mut names: Vec<String> = entries
            .into_iter()
            .flatten()
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .collect();
        names.sort();
        names
    }

    fn ports(&self) -> Check {
        let is_port = |name: &String| name.starts_with("ttyACM") || name.starts_with("ttyUSB");
        let ports: Vec<String> = self.names("dev").into_iter().filter(is_port).collect();
        if ports.is_empty() {
            return Check::good("ports", "no USB serial port; a virtual console needs none");
        }
        let me = Me::of(&self.read("proc/self/status").unwrap_or_default());
        let closed = |name: &&String| !me.may_open(&self.root.join("dev").join(name));
        let closed: Vec<&str> = ports.iter().filter(closed).map(String::as_str).collect();
        if closed.is_empty() {
            return Check::good("ports", ports.join(", "));
        }
        let found = format!("no permission to open {}", closed.join(", "));
        Check::bad("ports", found, UDEV)
    }

    fn latency_timers(&self) -> Check {
        const NAME: &str = "latency_timer";
        const FOLDER: &str = "sys/bus/usb-serial/devices";
        let timer = |bridge: String| {
            let text = self.read(&format!("{FOLDER}/{bridge}/latency_timer"))?;
            Some((bridge, text.trim().parse::<u32>().ok()?))
        };
        let timers: Vec<(String, u32)> = self.names(FOLDER).into_iter().filter_map(timer).collect();
        let told = |(bridge, ms): &(String, u32)| format!("{bridge}: {ms} ms");
        match timers.iter().find(|(_, ms)| *ms > LATENCY_MS) {
            Some(slow) => Check::bad(
                NAME,
                format!("{}: it holds bytes back for as long", told(slow)),
                format!(
                    "echo {LATENCY_MS} | sudo tee /{FOLDER}/{}/latency_timer",
                    slow.0
                ),
            ),
            None if timers.is_empty() => Check::good(NAME, "no serial bridge that has one"),
            None => Check::good(NAME, timers.iter().map(told).collect::<Vec<_>>().join(", ")),
        }
    }

    fn modem_manager(&self) -> Check {
        let is_process = |name: &String| name.bytes().all(|byte| byte.is_ascii_digit());
        let runs = self.names("proc").into_iter().filter(is_process).any(|id| {
            let name = self.read(&format!("proc/{id}/comm"));
            name.is_some_and(|name| name.trim() == "ModemManager")
        });
        if runs {
            let found = "it runs, and talks to every new serial port for 10 s";
            Check::bad(
                "modem_manager",
                found,
                "sudo systemctl disable --now ModemManager",
            )
        } else {
            Check::good("modem_manager", "it does not run")
        }
    }

    fn real_time(&self) -> Check {
        const NAME: &str = "real_time";
        let highest = Role::Console.priority();
        let me = Me::of(&self.read("proc/self/status").unwrap_or_default());
        match self.limit("Max realtime priority") {
            _ if me.has(CAP_SYS_NICE) => Check::good(NAME, "allowed: `sutura run` asks for it"),
            Some(Limit::None) => Check::good(NAME, "allowed: `sutura run` asks for it"),
            Some(Limit::At(limit)) if limit >= u64::from(highest) => {
                let found = format!("allowed up to priority {limit}: `sutura run` asks for it");
                Check::good(NAME, found)
            }
            Some(Limit::At(limit @ 1..)) => {
                let found = format!("allowed up to priority {limit}; a session asks for {highest}");
                Check::bad(NAME, found, PERMIT)
            }
            _ => Check::bad(
                NAME,
                "this user may not use real-time scheduling: any busy program delays host and link",
                PERMIT,
            ),
        }
    }

    fn locked_memory(&self) -> Check {
        const NAME: &str = "locked_memory";
        let me = Me::of(&self.read("proc/self/status").unwrap_or_default());
        match self.limit("Max locked memory") {
            _ if me.has(CAP_IPC_LOCK) => Check::good(NAME, "allowed: `sutura run` asks for it"),
            Some(Limit::None) => Check::good(NAME, "allowed: `sutura run` asks for it"),
            limit => {
                let mb = match limit {
                    Some(Limit::At(bytes)) => bytes >> 20,
                    _ => 0,
                };
                let found = format!(
                    "this user may keep {mb} MB in memory: a step may wait for a page that was put out to disk"
                );
                Check::bad(NAME, found, PERMIT)
            }
        }
    }

    /// What this process may have at most.
    fn limit(&self, name: &str) -> Option<Limit> {
        let limits = self.read("proc/self/limits")?;
        let rest = limits.lines().find_map(|line| line.strip_prefix(name))?;
        match rest.split_whitespace().next()? {
            "unlimited" => Some(Limit::None),
            number => number.parse().ok().map(Limit::At),
        }
    }

    fn preemption(&self) -> Check {
        const NAME: &str = "preemption";
        let version = self.read("proc/version").unwrap_or_default();
        let real_time = self
            .read("sys/kernel/realtime")
            .is_some_and(|text| text.trim() == "1");
        let model = version
            .split_whitespace()
            .find(|word| word.starts_with("PREEMPT"));
        match model {
            _ if real_time => Check::good(NAME, "PREEMPT_RT"),
            Some(model) => Check::good(NAME, model),
            None => Check::bad(
                NAME,
                "the kernel does not preempt itself: wake-ups may be late by many milliseconds",
                "install a kernel with PREEMPT_DYNAMIC (any distribution's since 2022) and boot it with preempt=full",
            ),
        }
    }

    fn governor(&self) -> Check {
        const NAME: &str = "governor";
        const FOLDER: &str = "sys/devices/system/cpu";
        let mut governors: Vec<String> = self
            .names(FOLDER)
            .into_iter()
            .filter_map(|cpu| self.read(&format!("{FOLDER}/{cpu}/cpufreq/scaling_governor")))
            .map(|text| text.trim().to_owned())
            .collect();
        governors.sort();
        governors.dedup();
        let is_slow = |name: &String| name != "performance";
        match governors.iter().find(|name| is_slow(name)) {
            Some(slow) => Check::bad(
                NAME,
                format!("{slow}: the clock rises only after the load has come"),
                "sudo cpupower frequency-set -g performance",
            ),
            None if governors.is_empty() => Check::good(NAME, "the clock is not scaled here"),
            None => Check::good(NAME, "performance"),
        }
    }
}

/// Who runs this program.
#[derive(Debug, Default)]
struct Me {
    user: u32,
    groups: Vec<u32>,
    capabilities: u64,
}

impl Me {
    /// From the text of /proc/self/status.
    fn of(status: &str) -> Me {
        let line = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name));
            line.unwrap_or_default().split_whitespace()
        };
        // Real, effective, saved, of the file system.
        let effective = |name| line(name).nth(1).and_then(|id| id.parse().ok());
        let mut groups: Vec<u32> = line("Groups:").filter_map(|id| id.parse().ok()).collect();
        groups.extend(effective("Gid:"));
        Me {
            user: effective("Uid:").unwrap_or(u32::MAX),
            groups,
            capabilities: line("CapEff:")
                .next()
                .and_then(|hex| u64::from_str_radix(hex, 16).ok())
                .unwrap_or_default(),
        }
    }

    fn has(&self, capability: u32) -> bool {
        self.capabilities >> capability & 1 == 1
    }

    /// Whether it may read and write a file.
    #[cfg(unix)]
    fn may_open(&self, path: &Path) -> bool {
        use std::os::unix::fs::MetadataExt;
        const READ_WRITE: u32 = 0o6;
        let Ok(file) = fs::metadata(path) else {
            return false;
        };
        let bits = match file.uid() {
            _ if self.user == 0 => READ_WRITE,
            owner if owner == self.user => file.mode() >> 6,
            _ if self.groups.contains(&file.gid()) => file.mode() >> 3,
            _ => file.mode(),
        };
        bits & READ_WRITE == READ_WRITE
    }

    #[cfg(not(unix))]
    fn may_open(&self, _: &Path) -> bool {
        true
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    /// A machine with these files.
    fn machine(files: &[(&str, &str)]) -> (tempfile::TempDir, System) {
        let root = tempfile::tempdir().expect("a folder");
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().expect("a parent")).expect("a folder");
            fs::write(&path, text).expect("a file");
        }
        let system = System::at(root.path());
        (root, system)
    }

    fn check(system: &System, name: &str) -> Check {
        let mut checks = system.checks().into_iter();
        checks
            .find(|check| check.name == name)
            .expect("a check of that name")
    }

    /// Somebody else's status: of no use for the files that this test makes, but by the group.
    const STRANGER: &str = "Name:\tsutura\nUid:\t12345\t12345\t12345\t12345\nGid:\t54321\t54321\t54321\t54321\nGroups:\t4 24 \nCapEff:\t0000000000000000\n";

    #[test]
    fn a_machine_without_anything_has_nothing_wrong_but_what_a_kernel_should_say() {
        let (_root, system) = machine(&[]);
        for name in ["ports", "latency_timer", "modem_manager", "governor"] {
            let check = check(&system, name);
            assert!(check.ok && check.fix.is_none(), "{check:?}");
        }
        for name in ["real_time", "locked_memory", "preemption"] {
            let check = check(&system, name);
            assert!(!check.ok && check.fix.is_some(), "{check:?}");
        }
    }

    #[test]
    fn a_port_that_others_may_open_has_the_rule_that_opens_it() {
        let files = [
            ("dev/ttyACM0", ""),
            ("dev/tty1", ""),
            ("proc/self/status", STRANGER),
        ];
        let (root, system) = machine(&files);
        let port = root.path().join("dev/ttyACM0");
        let mode = |bits| fs::set_permissions(&port, fs::Permissions::from_mode(bits));
        mode(0o660).expect("a mode");
        let closed = check(&system, "ports");
        assert!(!closed.ok && closed.found.contains("ttyACM0"), "{closed:?}");
        assert!(closed.fix.is_some_and(|fix| fix.contains("uaccess")));
        mode(0o666).expect("a mode");
        let open = check(&system, "ports");
        assert!(open.ok && open.found == "ttyACM0", "{open:?}");
    }

    #[test]
    fn a_bridge_that_holds_bytes_back_is_named_with_its_file() {
        const TIMER: &str = "sys/bus/usb-serial/devices/ttyUSB0/latency_timer";
        let (_root, slow) = machine(&[(TIMER, "16\n")]);
        let slow = check(&slow, "latency_timer");
        assert!(
            !slow.ok && slow.found.starts_with("ttyUSB0: 16 ms"),
            "{slow:?}"
        );
        assert_eq!(slow.fix, Some(format!("echo 1 | sudo tee /{TIMER}")));
        let (_root, fast) = machine(&[(TIMER, "1\n")]);
        assert!(check(&fast, "latency_timer").ok);
    }

    #[test]
    fn modem_manager_is_found_by_its_process() {
        let (_root, with) = machine(&[
            ("proc/1/comm", "init\n"),
            ("proc/77/comm", "ModemManager\n"),
        ]);
        assert!(!check(&with, "modem_manager").ok);
        let (_root, without) = machine(&[
            ("proc/1/comm", "init\n"),
            ("proc/self/comm", "ModemManager"),
        ]);
        assert!(check(&without, "modem_manager").ok);
    }

    #[test]
    fn scheduling_follows_limits_and_capabilities() {
        let limit = |priority: &str| {
            format!(
                "Limit                     Soft Limit           Hard Limit           Units\nMax realtime priority     {priority}  99 \n"
            )
        };
        for (status, priority, ok) in [
            (STRANGER, "0", false),
            (STRANGER, "80", true),
            // Not enough for the console's thread.
            (STRANGER, "11", false),
            (STRANGER, "12", true),
            (STRANGER, "unlimited", true),
            ("CapEff:\t0000000000800000\n", "0", true),
            ("CapEff:\t0000000000400000\n", "0", false),
        ] {
            let limits = limit(priority);
            let (_root, system) =
                machine(&[("proc/self/status", status), ("proc/self/limits", &limits)]);
            let found = check(&system, "real_time");
            assert_eq!(found.ok, ok, "{priority}: {found:?}");
        }
    }

    #[test]
    fn locked_memory_follows_limits_and_capabilities() {
        for (status, limit, ok) in [
            (STRANGER, "8388608", false),
            (STRANGER, "unlimited", true),
            ("CapEff:\t0000000000004000\n", "8388608", true),
            ("CapEff:\t0000000000800000\n", "8388608", false),
        ] {
            let limits = format!("Max locked memory         {limit}  {limit}  bytes\n");
            let (_root, system) =
                machine(&[("proc/self/status", status), ("proc/self/limits", &limits)]);
            let found = check(&system, "locked_memory");
            assert_eq!(found.ok, ok, "{limit}: {found:?}");
            if !ok {
                assert!(found.found.contains("8 MB"), "{found:?}");
                assert!(found.fix.is_some_and(|fix| fix.contains("memlock")));
            }
        }
    }

    #[test]
    fn kernel_and_clock_are_read() {
        let version = "Linux version 6.1.0 (a@b) (gcc) #1 SMP PREEMPT_DYNAMIC Debian\n";
        let governor =
            |name: &str| format!("sys/devices/system/cpu/{name}/cpufreq/scaling_governor");
        let (first, second) = (governor("cpu0"), governor("cpu1"));
        let (_root, system) = machine(&[
            ("proc/version", version),
            (&first, "performance\n"),
            (&second, "powersave\n"),
        ]);
        assert_eq!(check(&system, "preemption").found, "PREEMPT_DYNAMIC");
        let clock = check(&system, "governor");
        assert!(
            !clock.ok && clock.found.starts_with("powersave"),
            "{clock:?}"
        );
        let (_root, system) = machine(&[(&first, "performance\n"), ("sys/kernel/realtime", "1\n")]);
        assert!(check(&system, "governor").ok);
        assert_eq!(check(&system, "preemption").found, "PREEMPT_RT");
    }
}
