//! Checks of the offsets and lengths in an Arrow IPC file.
//!
//! Arrow's reader trusts them and allocates what a damaged length says, which may abort the
//! program.

use super::error::LogFault;
use arrow_ipc::reader::read_footer_length;
use arrow_ipc::{
    Block, CompressionType, MessageHeader, RecordBatch, root_as_footer, root_as_message,
};

/// Length of the footer and the magic bytes behind it.
const TAIL: usize = 10;
/// First bytes of a message since version 0.15 of the format. The length follows.
const CONTINUATION: [u8; 4] = [0xff; 4];
/// Bytes of the uncompressed length before a compressed buffer.
const PREFIX: usize = 8;
/// Marks a buffer that is not compressed.
const NOT_COMPRESSED: i64 = -1;
/// Maximum size of a column, bytes.
const MAX_COLUMN: i64 = 1 << 28;

/// Checks every offset and length of a file.
pub(super) fn check(bytes: &[u8]) -> Result<(), LogFault> {
    let Some((rest, tail)) = bytes.split_last_chunk::<TAIL>() else {
        return Err(LogFault::Damaged {
            part: "file",
            number: 0,
        });
    };
    let length = read_footer_length(*tail)?;
    let begin = rest.len().checked_sub(length).ok_or(LogFault::Damaged {
        part: "footer",
        number: 0,
    })?;
    let footer = root_as_footer(&rest[begin..]).map_err(|_| LogFault::Damaged {
        part: "footer",
        number: 0,
    })?;
    let blocks = footer
        .dictionaries()
        .into_iter()
        .flatten()
        .chain(footer.recordBatches().into_iter().flatten());
    for (number, block) in blocks.enumerate() {
        check_block(rest, block).ok_or(LogFault::Damaged {
            part: "block",
            number,
        })?;
    }
    Ok(())
}

/// `None` if a block, or a buffer in it, is out of bounds.
fn check_block(bytes: &[u8], block: &Block) -> Option<()> {
    let from = usize::try_from(block.offset()).ok()?;
    let body_from = from.checked_add(usize::try_from(block.metaDataLength()).ok()?)?;
    let body_to = body_from.checked_add(usize::try_from(block.bodyLength()).ok()?)?;
    let (message, body) = (bytes.get(from..body_from)?, bytes.get(body_from..body_to)?);
    let message = message
        .strip_prefix(&CONTINUATION)
        .unwrap_or(message)
        .get(CONTINUATION.len()..)?;
    let message = root_as_message(message).ok()?;
    match message.header_type() {
        MessageHeader::RecordBatch => check_batch(body, message.header_as_record_batch()?),
        MessageHeader::DictionaryBatch => {
            check_batch(body, message.header_as_dictionary_batch()?.data()?)
        }
        _ => None,
    }
}

fn check_batch(body: &[u8], batch: RecordBatch<'_>) -> Option<()> {
    let compressed = match batch.compression().map(|compression| compression.codec()) {
        None => false,
        Some(CompressionType::LZ4_FRAME | CompressionType::ZSTD) => true,
        Some(_) => return None,
    };
    for buffer in batch.buffers().into_iter().flatten() {
        let from = usize::try_from(buffer.offset()).ok()?;
        let to = from.checked_add(usize::try_from(buffer.length()).ok()?)?;
        let buffer = body.get(from..to)?;
        if compressed && !buffer.is_empty() {
            let prefix: [u8; PREFIX] = buffer.get(..PREFIX)?.try_into().ok()?;
            let length = i64::from_le_bytes(prefix);
            if !(NOT_COMPRESSED..=MAX_COLUMN).contains(&length) {
                return None;
            }
        }
    }
    Some(())
}
