//! Byte pipes to a console, and opening one with errors that say what to do next.
//!
//! Entry points: [`Port`], [`open_serial`], [`consoles`]. Serial ports go through the `serialport` crate; a
//! USB console ignores the line rate, the emulator's UART has none.

use super::LinkError;
use super::holder::holder;
use serialport::{SerialPort, SerialPortInfo, SerialPortType};
use std::io;
use std::time::Duration;
use sutura_shared::usb::{PRODUCT, VENDOR};

/// A byte pipe to a console, over which frames travel both ways.
pub trait Port: Send {
    /// What the user calls it.
    fn name(&self) -> String;

    /// Reads what is there, waiting at most `wait` for a first byte; 0 bytes when none came.
    ///
    /// # Errors
    /// `BrokenPipe` when the other end is gone for good; anything else that the system reports.
    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize>;

    /// Writes as much of `bytes` as the pipe takes now; may be 0.
    ///
    /// # Errors
    /// As [`Port::read`].
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;

    /// A second handle to the same port, so that one thread reads while another writes.
    ///
    /// # Errors
    /// When the system refuses another handle.
    fn try_clone(&self) -> io::Result<Box<dyn Port>>;
}

/// Line rate asked of a serial port that has one \[baud\]: what FTDI and ST-Link bridges reach reliably.
const BAUD: u32 = 921_600;

/// How long a write waits for room before the port counts as stuck this time round.
const WRITE_WAIT: Duration = Duration::from_millis(20);

struct Serial {
    name: String,
    port: Box<dyn SerialPort>,
}

/// A console on USB, which says so.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConsolePort {
    /// Name of its serial port.
    pub port: String,
    /// Its chip's number: 24 hexadecimal digits.
    pub serial_number: String,
}

/// The consoles on USB, by serial number.
pub fn consoles() -> Vec<ConsolePort> {
    let ports = serialport::available_ports().unwrap_or_default();
    consoles_of(&ports)
}

/// Vendor and product number, and a chip's number, which makes one of ours.
fn consoles_of(ports: &[SerialPortInfo]) -> Vec<ConsolePort> {
    let ours = |port: &SerialPortInfo| match &port.port_type {
        SerialPortType::UsbPort(usb) if (usb.vid, usb.pid) == (VENDOR, PRODUCT) => {
            let serial_number = usb.serial_number.clone()?;
            is_serial_number(&serial_number).then(|| ConsolePort {
                // macOS has each port twice; the one that does not wait for a carrier is the one to open.
                port: port.port_name.replace("/dev/tty.", "/dev/cu."),
                serial_number: serial_number.to_ascii_uppercase(),
            })
        }
        _ => None,
    };
    let mut found: Vec<_> = ports.iter().filter_map(ours).collect();
    found.sort_by(|a, b| (&a.serial_number, &a.port).cmp(&(&b.serial_number, &b.port)));
    found.dedup();
    found
}

/// Whether this is what a console's USB serial number looks like.
fn is_serial_number(name: &str) -> bool {
    name.len() == 24 && name.bytes().all(|digit| digit.is_ascii_hexdigit())
}

/// The port that is meant: a serial number's, of these consoles, or the one of that name.
fn port_of(name: &str, consoles: impl FnOnce() -> Vec<ConsolePort>) -> Result<String, LinkError> {
    if !is_serial_number(name) {
        return Ok(name.to_owned());
    }
    let consoles = consoles();
    let own = |console: &&ConsolePort| console.serial_number.eq_ignore_ascii_case(name);
    match consoles.iter().find(own) {
        Some(console) => Ok(console.port.clone()),
        None => {
            let shown =
                |console: ConsolePort| format!("{} ({})", console.port, console.serial_number);
            Err(LinkError::NoPort {
                name: name.to_owned(),
                found: consoles.into_iter().map(shown).collect::<Vec<_>>().into(),
            })
        }
    }
}

/// Opens a serial port or a pseudo-terminal, by its name, or a console on USB by its serial number. Opened again by that it is found
/// wherever it has come back.
///
/// # Errors
/// [`LinkError::NoPort`] with the ports that were found, [`LinkError::Permission`], [`LinkError::Busy`],
/// or [`LinkError::Open`] with what the system said.
pub fn open_serial(name: &str) -> Result<Box<dyn Port>, LinkError> {
    let path = port_of(name, consoles)?;
    let path = path.as_str();
    let builder = serialport::new(path, BAUD)
        .timeout(WRITE_WAIT)
        .dtr_on_open(true);
    #[cfg(unix)]
    let opened = open_unix(path, &builder);
    #[cfg(not(unix))]
    let opened = builder.open();
    let port = opened.map_err(|error| explain(path, &error))?;
    // Bytes from before the session are of no use; a port that cannot drop them only costs a few rejects.
    if let Err(error) = port.clear(serialport::ClearBuffer::Input) {
        tracing::debug!("{path}: input not cleared: {error}");
    }
    #[cfg(target_os = "linux")]
    shorten_latency(std::path::Path::new("/"), std::path::Path::new(path));
    Ok(Box::new(Serial {
        name: path.to_owned(),
        port,
    }))
}

/// Line rate that asks a board to go into its ROM's loader, as many boards with USB take it \[baud\].
const TOUCH_BAUD: u32 = 1200;

/// Asks a running console to go into the loader of its ROM, so that its firmware can be written: opens its port, by its name or serial
/// number, at 1200 baud and says that the terminal is gone. A console that is not at rest stays what it is; whether it went is for
/// the caller to see.
///
/// # Errors
/// As [`open_serial`].
pub fn touch(name: &str) -> Result<(), LinkError> {
    let path = port_of(name, consoles)?;
    let builder = serialport::new(&path, TOUCH_BAUD).dtr_on_open(true);
    let mut port = builder.open().map_err(|error| explain(&path, &error))?;
    // A console that is gone by now cannot answer, and closing the port says it again.
    if let Err(error) = port.write_data_terminal_ready(false) {
        tracing::debug!("{path}: terminal ready not taken back: {error}");
    }
    Ok(())
}

/// Has an FTDI bridge pass bytes on after 1 ms, where the system lets us: it keeps them for 16 ms otherwise. `root` is that
/// of the file system. `sutura doctor` tells whoever may not write there how to.
#[cfg(target_os = "linux")]
fn shorten_latency(root: &std::path::Path, port: &std::path::Path) {
    const LATENCY_MS: u32 = 1;
    let Ok(device) = std::fs::canonicalize(port) else {
        return;
    };
    let Some(name) = device.file_name() else {
        return;
    };
    let timer = root
        .join("sys/bus/usb-serial/devices")
        .join(name)
        .join("latency_timer");
    let text = std::fs::read_to_string(&timer).unwrap_or_default();
    if text.trim().parse().is_ok_and(|ms: u32| ms > LATENCY_MS)
        && let Err(error) = std::fs::write(&timer, LATENCY_MS.to_string())
    {
        tracing::warn!("{} stays {} ms: {error}", timer.display(), text.trim());
    }
}

#[cfg(unix)]
fn open_unix(
    path: &str,
    builder: &serialport::SerialPortBuilder,
) -> serialport::Result<Box<dyn SerialPort>> {
    let pseudo = std::fs::canonicalize(path).is_ok_and(|real| real.starts_with("/dev/pts"));
    // macOS refuses a line rate on a pseudo-terminal; it has none anyway.
    let builder = if pseudo {
        builder
            .clone()
            .baud_rate(if cfg!(target_os = "macos") { 0 } else { BAUD })
    } else {
        builder.clone()
    };
    let mut port = builder.open_native()?;
    if pseudo {
        // The kernel's exclusive flag would outlive a killed host for as long as the console holds the
        // terminal. The file lock that stays ends with the process, and keeps other hosts out all the same.
        port.set_exclusive(false)?;
    }
    Ok(Box::new(port))
}

/// Which mistake or which state of the machine is behind a failed open.
fn explain(path: &str, error: &serialport::Error) -> LinkError {
    use serialport::ErrorKind as Kind;
    let name = path.to_owned();
    if let Some(what) = no_terminal(path, &error.description) {
        let reason = format!("it is {what}, and no terminal");
        return LinkError::Open { name, reason };
    }
    match error.kind() {
        Kind::Io(io::ErrorKind::NotFound) => LinkError::NoPort {
            name,
            found: serial_ports().into(),
        },
        Kind::Io(io::ErrorKind::PermissionDenied) => LinkError::Permission { name },
        // `serialport` reports a locked port as a missing device.
        Kind::NoDevice if std::path::Path::new(path).exists() => LinkError::Busy {
            by: holder(path),
            name,
        },
        Kind::NoDevice => LinkError::NoPort {
            name,
            found: serial_ports().into(),
        },
        _ => LinkError::Open {
            name,
            reason: error.description.clone(),
        },
    }
}

/// Names what stands at a path and is no terminal; none for one, and where nothing stands.
fn no_terminal(path: &str, said: &str) -> Option<&'static str> {
    let of = std::fs::metadata(path).ok()?.file_type();
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if of.is_fifo() || of.is_socket() {
            return Some("a pipe");
        }
        // ENOTTY, as C libraries say it.
        let is_none = ["typewriter", "ioctl", "Not a tty"]
            .iter()
            .any(|words| said.contains(words));
        if of.is_char_device() && is_none {
            return Some("a device");
        }
    }
    #[cfg(not(unix))]
    let _ = said;
    match (of.is_dir(), of.is_file()) {
        (true, _) => Some("a folder"),
        (_, true) => Some("a file"),
        _ => None,
    }
}

/// Names of the serial ports of this machine, with what is plugged in where that is known.
pub fn serial_ports() -> Vec<String> {
    let ports = serialport::available_ports().unwrap_or_default();
    ports
        .into_iter()
        .map(|port| match port.port_type {
            SerialPortType::UsbPort(usb) => {
                format!(
                    "{} ({})",
                    port.port_name,
                    usb.product.unwrap_or_else(|| "USB".to_owned())
                )
            }
            _ => port.port_name,
        })
        .collect()
}

/// Nothing came, or nothing fitted, in time: not an error for us.
fn none_in_time(error: io::Error) -> io::Result<usize> {
    match error.kind() {
        io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted => Ok(0),
        // A terminal whose other end is closed reports an input/output error instead.
        io::ErrorKind::Other if error.raw_os_error().is_none() => {
            Err(io::ErrorKind::BrokenPipe.into())
        }
        _ => Err(error),
    }
}

impl Port for Serial {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.port.set_timeout(wait)?;
        match self.port.read(into) {
            // A terminal at end of file: the other end is gone.
            Ok(0) if !into.is_empty() => Err(io::ErrorKind::BrokenPipe.into()),
            Ok(count) => Ok(count),
            Err(error) => none_in_time(error),
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.port.write(bytes).or_else(none_in_time)
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        Ok(Box::new(Serial {
            name: self.name.clone(),
            port: self.port.try_clone()?,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_port_names_it_and_the_next_step() {
        let Err(error) = open_serial("/dev/no-such-console") else {
            panic!("opened")
        };
        assert!(
            matches!(&error, LinkError::NoPort { name, .. } if name == "/dev/no-such-console"),
            "{error:?}"
        );
        assert!(error.to_string().contains("/dev/no-such-console"));
        assert!(error.help().contains("virtual"), "{}", error.help());
    }

    const NUMBERS: [&str; 2] = ["0043002B3438510B32363530", "0043002B3438510B32363531"];

    fn usb(name: &str, pid: u16, serial_number: Option<&str>) -> SerialPortInfo {
        SerialPortInfo {
            port_name: name.to_owned(),
            port_type: SerialPortType::UsbPort(serialport::UsbPortInfo {
                vid: 0x16C0,
                pid,
                serial_number: serial_number.map(str::to_owned),
                manufacturer: None,
                product: None,
            }),
        }
    }

    #[test]
    fn consoles_are_told_from_what_else_borrows_their_number() {
        let ports = [
            usb("/dev/ttyACM1", 0x27DD, Some(NUMBERS[1])),
            usb("/dev/ttyACM0", 0x27DD, Some(&NUMBERS[0].to_lowercase())),
            usb("/dev/ttyACM2", 0x27DD, Some("1")),
            usb("/dev/ttyACM3", 0x27DD, None),
            usb("/dev/ttyACM4", 0x05DF, Some(NUMBERS[0])),
            SerialPortInfo {
                port_name: "/dev/ttyS0".to_owned(),
                port_type: SerialPortType::Unknown,
            },
        ];
        let found = consoles_of(&ports);
        let expected = [(0, "/dev/ttyACM0"), (1, "/dev/ttyACM1")].map(|(at, port)| ConsolePort {
            port: port.to_owned(),
            serial_number: NUMBERS[at].to_owned(),
        });
        assert_eq!(found, expected);
    }

    #[test]
    fn a_serial_number_is_the_port_where_it_is_now() {
        let plugged = |port: &str| {
            let ports = [usb(port, 0x27DD, Some(NUMBERS[0]))];
            move || consoles_of(&ports)
        };
        for port in ["/dev/ttyACM0", "/dev/ttyACM7"] {
            let found = port_of(NUMBERS[0], plugged(port)).expect("it is there");
            assert_eq!(found, port);
            let small = NUMBERS[0].to_lowercase();
            assert_eq!(port_of(&small, plugged(port)).expect("it is there"), port);
        }
        // Nobody looks for a port's name.
        let name = port_of("/dev/ttyUSB0", || panic!("looked for")).expect("a name");
        assert_eq!(name, "/dev/ttyUSB0");
        let error = port_of(NUMBERS[1], plugged("/dev/ttyACM0")).expect_err("another one");
        let text = error.to_string();
        assert!(
            text.contains(NUMBERS[1]) && text.contains(NUMBERS[0]),
            "{text}"
        );
    }

    #[cfg(unix)]
    #[test]
    fn a_file_is_not_a_port() {
        let Err(error) = open_serial("/dev/null") else {
            panic!("opened")
        };
        assert!(matches!(error, LinkError::Open { .. }), "{error:?}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_bridge_that_holds_bytes_back_is_told_not_to() {
        let root = std::env::temp_dir().join(format!("sutura-latency-{}", std::process::id()));
        let port = root.join("ttyUSB3");
        let folder = root.join("sys/bus/usb-serial/devices/ttyUSB3");
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(&port, "").expect("a port");
        let timer = folder.join("latency_timer");
        for (before, after) in [("16\n", "1"), ("1\n", "1\n"), ("no number", "no number")] {
            std::fs::write(&timer, before).expect("a timer");
            shorten_latency(&root, &port);
            assert_eq!(std::fs::read_to_string(&timer).expect("a timer"), after);
        }
        // Ports without a bridge, and none at all.
        std::fs::remove_file(&timer).expect("a timer");
        shorten_latency(&root, &port);
        shorten_latency(&root, &root.join("ttyUSB4"));
        assert!(!timer.exists());
        std::fs::remove_dir_all(&root).expect("a folder");
    }
}
