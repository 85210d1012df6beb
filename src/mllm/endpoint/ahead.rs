//! A response that is read ahead, so that its reader can stop waiting for more.

use super::reply::Body;
use std::io::{self, Read};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Time for what follows a complete answer: the counts of tokens, and the end marker. Some servers
/// send neither, and leave the connection open.
const MAX_AFTER_ANSWER: Duration = Duration::from_secs(1);
/// Bytes that are read at once.
const READ_BYTES: usize = 8192;
/// Pieces that may wait for the reader.
const MAX_WAITING_PIECES: usize = 64;

pub(super) struct Ahead {
    pieces: Receiver<io::Result<Vec<u8>>>,
    /// What is left of the last piece.
    rest: Vec<u8>,
    taken: usize,
    /// When to wait no more; none while the answer is not complete.
    until: Option<Instant>,
    /// The end was reported, and stays.
    ended: bool,
}

impl Ahead {
    /// Reads a response in a thread of its own. The thread ends with the response, which has a time
    /// limit. It also ends with the first piece after this value is dropped.
    pub(super) fn new(response: impl Read + Send + 'static) -> Self {
        let (sender, pieces) = sync_channel(MAX_WAITING_PIECES);
        let failure = sender.clone();
        let thread = std::thread::Builder::new().name("planagent-reply".to_owned());
        if let Err(error) = thread.spawn(move || send_pieces(response, &sender)) {
            // An empty channel takes it at once, and the reader gets it in the place of a reply.
            failure.try_send(Err(error)).ok();
        }
        Self {
            pieces,
            rest: Vec::new(),
            taken: 0,
            until: None,
            ended: false,
        }
    }

    /// The next piece; an empty one at the end.
    fn next(&mut self) -> io::Result<Vec<u8>> {
        if self.ended {
            return Ok(Vec::new());
        }
        let piece = match self.until {
            None => self.pieces.recv().ok(),
            Some(until) => {
                let left = until.saturating_duration_since(Instant::now());
                self.pieces.recv_timeout(left).ok()
            }
        };
        self.ended = !matches!(piece, Some(Ok(_)));
        piece.unwrap_or(Ok(Vec::new()))
    }
}

fn send_pieces(mut response: impl Read, sender: &SyncSender<io::Result<Vec<u8>>>) {
    let mut buffer = vec![0; READ_BYTES];
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
