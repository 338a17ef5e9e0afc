//! QEMU's end of the gdb remote protocol: packets `$body#sum` over a local socket.
//!
//! Entry points: [`Gdb::connect`], [`Gdb::put`], [`Gdb::answers`]. Packets are queued and sent together, because a round trip
//! costs more than what it asks for. Nothing is acknowledged: QEMU takes the next packet for an acknowledgement.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

/// A connection to a gdb stub.
#[derive(Debug)]
pub struct Gdb {
    stream: UnixStream,
    /// Packets that wait to be sent.
    queued: Vec<u8>,
    /// How many answers those want.
    due: usize,
    /// What has come and has not been looked at.
    received: Vec<u8>,
    /// Where in it the next answer may begin.
    from: usize,
}

/// Interrupts what runs. Not a packet.
const BREAK: [u8; 1] = [3];

impl Gdb {
    /// Opens the stub's socket. An answer that does not come within `patience` is an error of kind `WouldBlock`.
    ///
    /// # Errors
    /// What the system says.
    pub fn connect(path: &Path, patience: Duration) -> io::Result<Gdb> {
        let stream = UnixStream::connect(path)?;
        stream.set_read_timeout(Some(patience))?;
        Ok(Gdb {
            stream,
            queued: Vec::new(),
            due: 0,
            received: Vec::new(),
            from: 0,
        })
    }

    /// Queues a packet.
    pub fn put(&mut self, body: &str) {
        let sum = body.bytes().fold(0_u8, u8::wrapping_add);
        self.queued
            .extend(format!("${body}#{sum:02x}").into_bytes());
        self.due += 1;
    }

    /// Sends what is queued; the answers, in order. What makes the processor run has to be the last, and is answered when it stops.
    ///
    /// # Errors
    /// What the system says.
    pub fn answers(&mut self) -> io::Result<Vec<String>> {
        self.stream.write_all(&self.queued)?;
        self.queued.clear();
        let due = std::mem::take(&mut self.due);
        (0..due).map(|_| self.answer()).collect()
    }

    /// Sends one packet, after those queued; its answer.
    ///
    /// # Errors
    /// What the system says.
    pub fn ask(&mut self, body: &str) -> io::Result<String> {
        self.put(body);
        Ok(self.answers()?.pop().unwrap_or_default())
    }

    /// Stops what runs and has not answered.
    ///
    /// # Errors
    /// What the system says.
    pub fn interrupt(&mut self) -> io::Result<String> {
        self.stream.write_all(&BREAK)?;
        self.answer()
    }

    fn answer(&mut self) -> io::Result<String> {
        loop {
            if let Some((body, next)) = packet(&self.received, self.from) {
                self.from = next;
                return Ok(body);
            }
            self.received.drain(..self.from);
            self.from = 0;
            let mut chunk = [0; 4096];
            let count = match self.stream.read(&mut chunk) {
                // A signal, or somebody who looks at this process.
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                read => read?,
            };
            if count == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            self.received.extend_from_slice(&chunk[..count]);
        }
    }
}

/// The first whole packet from a place on, and where it ends. Acknowledgements before it are passed over.
fn packet(bytes: &[u8], from: usize) -> Option<(String, usize)> {
    let find = |from: usize, mark: u8| {
        let rest = bytes.get(from..)?;
        rest.iter()
            .position(|byte| *byte == mark)
            .map(|at| from + at)
    };
    let start = find(from, b'$')? + 1;
    let end = find(start, b'#')?;
    // Two digits of the sum, which a local socket does not garble.
    let next = end + 3;
    (next <= bytes.len()).then(|| {
        (
            String::from_utf8_lossy(&bytes[start..end]).into_owned(),
            next,
        )
    })
}

/// A word as the protocol writes it: bytes in the order of memory.
pub fn hex_word(word: u32) -> String {
    format!("{:08x}", word.swap_bytes())
}

/// Words from what the protocol writes; what is no number ends them.
pub fn words(hex: &str) -> Vec<u32> {
    let digits = hex.as_bytes().chunks_exact(8);
    digits
        .map_while(|word| u32::from_str_radix(std::str::from_utf8(word).ok()?, 16).ok())
        .map(u32::swap_bytes)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_are_found_between_acknowledgements_and_halves_wait() {
        let bytes = b"+$OK#9a+$T05thread:01;#07+$12";
        let (first, next) = packet(bytes, 0).expect("a packet");
        assert_eq!(first, "OK");
        let (second, next) = packet(bytes, next).expect("another");
        assert_eq!(second, "T05thread:01;");
        assert_eq!(packet(bytes, next), None);
        assert_eq!(packet(b"$OK#9", 0), None, "half a sum");
    }

    #[test]
    fn words_are_in_the_order_of_memory() {
        assert_eq!(hex_word(0x0800_1234), "34120008");
        assert_eq!(words("34120008ffffffff"), [0x0800_1234, u32::MAX]);
        assert_eq!(words("34120008xxxxxxxx00000000"), [0x0800_1234]);
    }

    #[test]
    fn a_packet_ends_in_the_sum_of_its_bytes() {
        let (near, mut far) = UnixStream::pair().expect("a socket");
        let mut gdb = Gdb {
            stream: near,
            queued: Vec::new(),
            due: 0,
            received: Vec::new(),
            from: 0,
        };
        far.write_all(b"+$OK#9a+$S05#b8").expect("room");
        gdb.put("P0=00000001");
        assert_eq!(gdb.ask("c").expect("an answer"), "S05");
        let mut sent = [0; 20];
        far.read_exact(&mut sent).expect("two packets");
        assert_eq!(&sent, b"$P0=00000001#3e$c#63");
    }
}
