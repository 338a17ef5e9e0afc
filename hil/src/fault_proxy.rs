//! A port that does to the host's bytes what a bad line does: noise, loss, cuts.
//!
//! Entry point: [`FaultProxy::new`].

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use sutura_host::link::Port;

type Rule = Arc<Mutex<dyn FnMut(&[u8]) -> Vec<u8> + Send>>;

/// Hands every write to a rule, and what the rule makes of it to the port.
pub struct FaultProxy {
    port: Box<dyn Port>,
    rule: Rule,
}

impl FaultProxy {
    /// `rule` gets each write of the host, one frame at a time, and returns what goes on the line instead.
    pub fn new(port: Box<dyn Port>, rule: impl FnMut(&[u8]) -> Vec<u8> + Send + 'static) -> Self {
        FaultProxy {
            port,
            rule: Arc::new(Mutex::new(rule)),
        }
    }
}

impl Port for FaultProxy {
    fn name(&self) -> String {
        self.port.name()
    }

    fn read(&mut self, into: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.port.read(into, wait)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let changed = self.rule.lock().unwrap_or_else(PoisonError::into_inner)(bytes);
        let mut left = changed.as_slice();
        while !left.is_empty() {
            let count = self.port.write(left)?;
            left = &left[count..];
        }
        Ok(bytes.len())
    }

    fn try_clone(&self) -> io::Result<Box<dyn Port>> {
        Ok(Box::new(FaultProxy {
            port: self.port.try_clone()?,
            rule: self.rule.clone(),
        }))
    }
}
