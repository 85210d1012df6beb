//! A response that is read ahead, so that its reader can stop waiting for more.

use super::reply::Body;
use std::io::{self, Read};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Time for what follows an answer that is complete: counts, and the mark of the end. Some servers
/// send neither, and leave the connection open.
const MAX_AFTER_ANSWER: Duration = Duration::from_secs(1);
/// Bytes that are read at once, and pieces that may wait for the reader.
const PIECE: usize = 8192;
const WAITING: usize = 64;

pub(super) struct Ahead {
    pieces: Receiver<io::Result<Vec<u8>>>,
    /// What is left of the last piece.
    rest: Vec<u8>,
    taken: usize,
    /// When the bytes count as ended; none while the answer is not complete.
    until: Option<Instant>,
}

impl Ahead {
    /// Reads a response in a thread of its own. The thread ends with the response, which has a time
    /// limit, or with the next piece after this is dropped.
    pub(super) fn new(response: impl Read + Send + 'static) -> Self {
        let (sender, pieces) = sync_channel(WAITING);
        std::thread::spawn(move || send_pieces(response, &sender));
        Self {
            pieces,
            rest: Vec::new(),
            taken: 0,
            until: None,
        }
    }

    /// The next piece; an empty one at the end.
    fn next(&mut self) -> io::Result<Vec<u8>> {
        let Some(until) = self.until else {
            return self.pieces.recv().unwrap_or(Ok(Vec::new()));
        };
        let left = until.saturating_duration_since(Instant::now());
        match self.pieces.recv_timeout(left) {
            Ok(piece) => piece,
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => Ok(Vec::new()),
        }
    }
}

fn send_pieces(mut response: impl Read, sender: &SyncSender<io::Result<Vec<u8>>>) {
    let mut buffer = vec![0; PIECE];
    loop {
        let piece = match response.read(&mut buffer) {
            Ok(0) => return,
            Ok(count) => Ok(buffer.iter().take(count).copied().collect()),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => Err(error),
        };
        let ended = piece.is_err();
        if sender.send(piece).is_err() || ended {
            return;
        }
    }
}

impl Read for Ahead {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.taken >= self.rest.len() {
            self.rest = self.next()?;
            self.taken = 0;
        }
        let left = self.rest.get(self.taken..).unwrap_or(&[]);
        let count = left.len().min(buffer.len());
        if let (Some(to), Some(from)) = (buffer.get_mut(..count), left.get(..count)) {
            to.copy_from_slice(from);
        }
        self.taken += count;
        Ok(count)
    }
}

impl Body for Ahead {
    fn hurry(&mut self) {
        self.until
            .get_or_insert_with(|| Instant::now() + MAX_AFTER_ANSWER);
    }
}
