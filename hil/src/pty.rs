//! The console's side of a pseudo-terminal, which a host opens as it would open a serial port.
//!
//! Entry point: [`Pty::open`]. Writes never block, as a console's never do: when the host stops
//! reading, bytes are dropped at the console, and its control loop goes on.

use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::io::{self, ErrorKind};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;
use sutura_host::link::Port;

/// A symbolic link to a pseudo-terminal, which goes with this.
#[derive(Debug)]
pub struct PtyLink {
    link: PathBuf,
    path: PathBuf,
}

impl PtyLink {
    /// Makes a link to the terminal at `path`. One that a killed console has left behind is replaced: it leads to a
    /// pseudo-terminal that is gone, or that has come back as this one.
    ///
    /// # Errors
    /// The system's, if it cannot be made, or something else is there; [`ErrorKind::ResourceBusy`] for a link to another
    /// terminal.
    pub fn make(link: &Path, path: &str) -> io::Result<PtyLink> {
        let path = PathBuf::from(path);
        if let Ok(target) = std::fs::read_link(link) {
            let is_terminal = ["/dev/pts", "/dev/ttys"]
                .iter()
                .any(|of| target.starts_with(of));
            if target == path || (is_terminal && !link.exists()) {
                std::fs::remove_file(link)?;
            } else if is_terminal {
                let what = format!(
                    "it leads to {}, which another console or terminal uses",
                    target.display()
                );
                return Err(io::Error::new(ErrorKind::ResourceBusy, what));
            }
        }
        std::os::unix::fs::symlink(&path, link)?;
        Ok(PtyLink {
            link: link.to_owned(),
            path,
        })
    }
}

impl Drop for PtyLink {
    fn drop(&mut self) {
        // What somebody has put in its place stays.
        if std::fs::read_link(&self.link).is_ok_and(|target| target == self.path) {
            drop(std::fs::remove_file(&self.link));
        }
    }
}

/// The master side of a pseudo-terminal.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    /// The other side stays open here too, so that a host may come and go.
    terminal: OwnedFd,
    path: String,
}

impl Pty {
    /// Makes a new pseudo-terminal in raw mode.
    ///
    /// # Errors
    /// When the system has none left, or none at all.
    pub fn open() -> io::Result<Pty> {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        let path = ptsname(&master, Vec::new())?;
        let terminal = rustix::fs::open(
            &path,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        let mut settings = tcgetattr(&terminal)?;
        settings.make_raw();
        tcsetattr(&terminal, OptionalActions::Now, &settings)?;
        let flags = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
        rustix::io::fcntl_setfd(&master, rustix::io::FdFlags::CLOEXEC)?;
        Ok(Pty {
            master,
            terminal,
            path: path.to_string_lossy().into_owned(),
        })
    }

    /// The terminal's path, to be opened by the host.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Bytes that the host has not read yet; at least 1 while it is reading.
    ///
    /// # Errors
    /// What the system says.
    pub fn unread(&self) -> io::Result<u64> {
        // What is still on its way to the terminal comes there only when a look finds nothing there: where it finds something, more
        // may be behind that when the host has read it a moment later.
        let looked = &mut [rustix::event::PollFd::new(
            &self.terminal,
            rustix::event::PollFlags::IN,
        )];
        let found = rustix::event::poll(looked, Some(&rustix::event::Timespec::default()))?;
        let count = rustix::io::ioctl_fionread(&self.terminal)?;
        Ok(count.max(u64::from(found > 0)))
    }
}

/// Nothing there, or no room, is not an error.
fn none_now(error: rustix::io::Errno) -> io::Result<usize> {
    use rustix::io::Errno;
    if error == Errno::AGAIN || error == Errno::INTR {
        Ok(0)
    } else {
        Err(error.into())
    }
}

impl Port for Pty {
    fn name(&self) -> String {
        self.path.clone()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        if !wait.is_zero() {
            let timeout = rustix::event::Timespec::try_from(wait).map_err(io::Error::other)?;
            let mut fds = [rustix::event::PollFd::new(
                &self.master,
                rustix::event::PollFlags::IN,
            )];
            rustix::event::poll(&mut fds, Some(&timeout)).or_else(none_now)?;
        }
        rustix::io::read(&self.master, into).or_else(none_now)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        rustix::io::write(&self.master, bytes).or_else(none_now)
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        let (master, terminal) = (self.master.try_clone()?, self.terminal.try_clone()?);
        Ok(Box::new(Pty {
            master,
            terminal,
            path: self.path.clone(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;
    use sutura_host::link::{LinkError, open_serial};

    const LONG: Duration = Duration::from_secs(60);

    #[test]
    fn all_byte_values_cross_unchanged_both_ways() -> Result<(), Box<dyn Error>> {
        let mut console = Pty::open()?;
        let mut host = open_serial(console.path())?;
        let sent: Vec<u8> = (0..=255).collect();
        for (from, to) in [(0, 1), (1, 0)] {
            let ends: [&mut dyn Port; 2] = [&mut console, host.as_mut()];
            assert_eq!(ends[from].write(&sent)?, sent.len());
            let mut got = Vec::new();
            let mut chunk = [0; 64];
            while got.len() < sent.len() {
                let count = ends[to].read(&mut chunk, LONG)?;
                assert!(count > 0, "{got:?}");
                got.extend_from_slice(&chunk[..count]);
            }
            assert_eq!(got, sent);
        }
        Ok(())
    }

    #[test]
    fn what_a_host_has_not_read_is_counted_at_once() -> Result<(), Box<dyn Error>> {
        for count in 1..500 {
            let mut console = Pty::open()?;
            console.write(&vec![7; count])?;
            assert_eq!(console.unread()?, count as u64);
        }
        Ok(())
    }

    #[test]
    fn a_host_that_does_not_read_never_blocks_the_console() -> Result<(), Box<dyn Error>> {
        let mut console = Pty::open()?;
        let _host = open_serial(console.path())?;
        let mut taken = 0;
        for _ in 0..10_000 {
            taken += console.write(&[7; 100])?;
        }
        assert!(taken < 1_000_000, "{taken} bytes of 1,000,000 were taken");
        Ok(())
    }

    #[test]
    fn a_second_host_is_told_that_the_port_is_busy() -> Result<(), Box<dyn Error>> {
        let console = Pty::open()?;
        let first = open_serial(console.path())?;
        assert!(matches!(
            open_serial(console.path()),
            Err(LinkError::Busy { .. })
        ));
        drop(first);
        open_serial(console.path())?;
        Ok(())
    }

    #[test]
    fn the_host_notices_that_the_console_is_gone() -> Result<(), Box<dyn Error>> {
        let console = Pty::open()?;
        let mut host = open_serial(console.path())?;
        drop(console);
        assert_eq!(
            host.read(&mut [0; 8], LONG).map_err(|e| e.kind()),
            Err(ErrorKind::BrokenPipe)
        );
        Ok(())
    }
}
