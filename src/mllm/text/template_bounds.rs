//! Bounds of chat templates. They come with downloaded models, and they are programs: they may nest, loop and repeat texts.

use std::io::{self, Write};
use std::thread;

/// Longest template, bytes. Published ones have up to 30 KB. A template nests at most once a byte.
pub(super) const MAX_SOURCE_BYTES: usize = 64 << 10;
/// Instructions of one rendering. A chat of ten messages takes a few thousand.
pub(super) const MAX_STEPS: u64 = 500_000;
/// Calls of macros inside each other.
pub(super) const MAX_CALLS: usize = 50;
/// Bytes that a template may add to the texts of a chat.
const MAX_ADDED_BYTES: usize = 256 << 10;
/// How often a template may write the texts of a chat.
const MAX_COPIES: usize = 4;
/// Stack of the thread that compiles and renders, bytes: nesting takes up to 4 KB of stack a level, and a level at least a byte of
/// the template, or two instructions.
const STACK_BYTES: usize = MAX_SOURCE_BYTES * (4 << 10);

/// Runs work on a thread with a stack that no template within the bounds overflows.
///
/// # Errors
/// When the thread cannot be started, or the work panics.
pub(super) fn on_deep_stack<T: Send>(work: impl FnOnce() -> T + Send) -> io::Result<T> {
    thread::scope(|scope| {
        let builder = thread::Builder::new().name("chat template".to_owned()).stack_size(STACK_BYTES);
        builder.spawn_scoped(scope, work)?.join().map_err(|_| io::Error::other("the template engine panicked"))
    })
}

/// A text of limited length.
#[derive(Debug)]
pub(super) struct BoundedText {
    bytes: Vec<u8>,
    most: usize,
    is_exceeded: bool,
}

impl BoundedText {
    /// For a chat whose texts have `bytes` bytes.
    pub(super) fn of_chat(bytes: usize) -> Self {
        let most = bytes.saturating_mul(MAX_COPIES).saturating_add(MAX_ADDED_BYTES);
        Self { bytes: Vec::new(), most, is_exceeded: false }
    }

    /// The text, or what is wrong with it.
    pub(super) fn into_text(self) -> Result<String, String> {
        if self.is_exceeded {
            return Err(format!("the rendered chat has more than {} bytes", self.most));
        }
        // The template engine writes whole characters.
        Ok(String::from_utf8_lossy(&self.bytes).into_owned())
    }
}

impl Write for BoundedText {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.bytes.len().saturating_add(bytes.len()) > self.most {
            self.is_exceeded = true;
            return Err(io::Error::other("the rendered chat is too long"));
        }
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
