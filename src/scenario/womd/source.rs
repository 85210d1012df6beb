//! The bytes of a file of records: as they are, or unpacked from GZIP or ZLIB, the two compressions
//! that TFRecord's own library writes.

use super::tfrecord::is_header;
use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use planagent_files::{KIND_BYTES, kind_of};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// First bytes of GZIP.
const GZIP: &[u8] = b"\x1f\x8b";
/// First byte of ZLIB with the usual window; with the second, it is a multiple of 31.
const ZLIB: u8 = 0x78;
const ZLIB_CHECK: u16 = 31;

/// An opened file of records.
pub(super) enum Source {
    Plain(BufReader<File>),
    Packed(BufReader<Box<dyn Read + Send>>),
}

/// An opened file, and its size in bytes; none for one that is unpacked.
pub(super) struct Opened {
    pub(super) source: Source,
    pub(super) bytes: Option<u64>,
}

/// Opens a file of records. `Ok(Err(kind))` names a file of another kind.
pub(super) fn open(path: &Path) -> io::Result<Result<Opened, &'static str>> {
    let file = planagent_files::open(path)?;
    let bytes = file.metadata()?.len();
    let mut reader = BufReader::with_capacity(KIND_BYTES.max(8192), file);
    let beginning = reader.fill_buf()?.to_vec();
    if is_header(&beginning) {
        return Ok(Ok(Opened {
            source: Source::Plain(reader),
            bytes: Some(bytes),
        }));
    }
    let unpacked: Option<Box<dyn Read + Send>> = match beginning[..] {
        [first, second, ..] if [first, second] == *GZIP => {
            Some(Box::new(MultiGzDecoder::new(again(&mut reader)?)))
        }
        [ZLIB, second, ..] if u16::from_be_bytes([ZLIB, second]).is_multiple_of(ZLIB_CHECK) => {
            Some(Box::new(ZlibDecoder::new(again(&mut reader)?)))
        }
        _ => None,
    };
    if let Some(unpacked) = unpacked {
        let mut reader = BufReader::new(unpacked);
        // An archive of other things, such as a tar.gz, is called what it is.
        let beginning = reader.fill_buf()?;
        if !is_header(beginning)
            && let Some(kind) = kind_of(beginning)
        {
            return Ok(Err(kind));
        }
        return Ok(Ok(Opened {
            source: Source::Packed(reader),
            bytes: None,
        }));
    }
    match kind_of(&beginning) {
        Some(kind) => Ok(Err(kind)),
        None => Ok(Ok(Opened {
            source: Source::Plain(reader),
            bytes: Some(bytes),
        })),
    }
}

/// The same file from its beginning.
fn again(reader: &mut BufReader<File>) -> io::Result<BufReader<File>> {
    let mut file = reader.get_ref().try_clone()?;
    file.rewind()?;
    Ok(BufReader::new(file))
}

impl Read for Source {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(reader) => reader.read(buffer),
            Self::Packed(reader) => reader.read(buffer),
        }
    }
}

impl Seek for Source {
    /// Of an unpacked file only forward from here.
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match (self, to) {
            (Self::Plain(reader), to) => reader.seek(to),
            (Self::Packed(reader), SeekFrom::Current(skipped @ 0..)) => {
                let skipped = skipped as u64;
                let passed = io::copy(&mut reader.take(skipped), &mut io::sink())?;
                if passed < skipped {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                Ok(passed)
            }
            (Self::Packed(_), _) => Err(io::ErrorKind::Unsupported.into()),
        }
    }

    fn seek_relative(&mut self, offset: i64) -> io::Result<()> {
        match self {
            Self::Plain(reader) => reader.seek_relative(offset),
            Self::Packed(_) => self.seek(SeekFrom::Current(offset)).map(drop),
        }
    }
}
