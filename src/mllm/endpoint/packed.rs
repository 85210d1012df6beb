//! Compressed responses. No request asks for one, and some proxies compress all the same.

use super::encodings::Utf8;
use crate::EndpointFailure;
use brotli_decompressor::Decompressor;
use flate2::read::{DeflateDecoder, MultiGzDecoder, ZlibDecoder};
use reqwest::blocking::Response;
use reqwest::header::CONTENT_ENCODING;
use std::io::{self, Cursor, Read};

type Bytes = Box<dyn Read + Send>;

/// Bytes that brotli reads at once.
const BROTLI_BUFFER: usize = 4096;
/// Largest window of zstd, as a power of two: that of RFC 9659, 8 MiB.
const MAX_WINDOW_LOG: u32 = 23;
/// Most compressions one over the other.
const MAX_LAYERS: usize = 3;

/// The bytes of a response without its compression, as UTF-8. Their reader limits how many there
/// are.
///
/// # Errors
/// When the compression is another one; the text names it.
pub(super) fn unpacked(response: Response) -> Result<Bytes, EndpointFailure> {
    let named = response.headers().get(CONTENT_ENCODING);
    let names = named.map_or(Ok(""), |name| name.to_str()).unwrap_or("?");
    let names = names.to_ascii_lowercase();
    let plain = without(&names, response)?;
    Ok(Box::new(Utf8::new(plain)))
}

/// Bytes without compressions by their names in HTTP, the last of which was applied last.
fn without(names: &str, bytes: impl Read + Send + 'static) -> Result<Bytes, EndpointFailure> {
    let mut plain: Bytes = Box::new(bytes);
    for (layer, name) in names.rsplit(',').map(str::trim).enumerate() {
        plain = match name {
            _ if layer >= MAX_LAYERS => return Err(unknown(names)),
            "" | "identity" | "none" | "utf-8" => Box::new(Seen::Not {
                bytes: plain,
                named: false,
            }),
            "gzip" | "x-gzip" => Box::new(MultiGzDecoder::new(plain)),
            "deflate" => Box::new(Seen::Not {
                bytes: plain,
                named: true,
            }),
            "br" => Box::new(Decompressor::new(plain, BROTLI_BUFFER)),
            "zstd" => zstd_of(plain).map_err(|_| unknown(names))?,
            _ => return Err(unknown(names)),
        };
    }
    Ok(plain)
}

fn zstd_of(bytes: Bytes) -> io::Result<Bytes> {
    let mut plain = zstd::Decoder::new(bytes)?;
    plain.window_log_max(MAX_WINDOW_LOG)?;
    Ok(Box::new(plain))
}

fn unknown(names: &str) -> EndpointFailure {
    EndpointFailure::InvalidReply(format!(
        "the reply is compressed ({names}), which the request did not ask for; switch compression off in the server or in \
         the proxy before it"
    ))
}

/// Bytes whose first two say how they are packed: `deflate` has a header of zlib, which some servers
/// leave out, and some proxies take away the name of gzip alone.
enum Seen {
    Not { bytes: Bytes, named: bool },
    Begun(Bytes),
}

impl Seen {
    fn begun(mut bytes: Bytes, named: bool) -> io::Result<Bytes> {
        let mut first = Vec::new();
        bytes.by_ref().take(2).read_to_end(&mut first)?;
        // RFC 1950: the method is 8, and both bytes as a number are a multiple of 31.
        let has_header = matches!(first[..], [method, flags]
            if method & 15 == 8 && u16::from_be_bytes([method, flags]).is_multiple_of(31));
        let is_gzip = first == [0x1f, 0x8b];
        let all = Cursor::new(first).chain(bytes);
        Ok(match named {
            false if is_gzip => Box::new(MultiGzDecoder::new(all)),
            false => Box::new(all),
            true if has_header => Box::new(ZlibDecoder::new(all)),
            true => Box::new(DeflateDecoder::new(all)),
        })
    }
}

impl Read for Seen {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if let Self::Not { bytes, named } = self {
            let bytes = std::mem::replace(bytes, Box::new(io::empty()));
            *self = Self::Begun(Self::begun(bytes, *named)?);
        }
        match self {
            Self::Not { bytes, .. } | Self::Begun(bytes) => bytes.read(buffer),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::read::{DeflateEncoder, GzEncoder, ZlibEncoder};

    const TEXT: &[u8] = b"{\"choices\": []}";

    fn all(mut bytes: impl Read) -> Vec<u8> {
        let mut read = Vec::new();
        bytes.read_to_end(&mut read).unwrap();
        read
    }

    #[test]
    fn a_compressed_reply_is_read_or_its_compression_is_named() {
        let fast = Compression::fast();
        let gzip = all(GzEncoder::new(TEXT, fast));
        for (names, packed) in [
            ("", TEXT.to_vec()),
            ("identity", TEXT.to_vec()),
            ("gzip", gzip.clone()),
            ("", gzip.clone()),
            ("deflate", all(ZlibEncoder::new(TEXT, fast))),
            ("deflate", all(DeflateEncoder::new(TEXT, fast))),
            ("zstd", zstd::encode_all(TEXT, 1).unwrap()),
            // A stored block of RFC 7932, made by hand.
            ("br", [&[0x0b, 0x07, 0x80], TEXT, &[0x03]].concat()),
            ("deflate, gzip", {
                all(GzEncoder::new(&all(ZlibEncoder::new(TEXT, fast))[..], fast))
            }),
        ] {
            assert_eq!(
                all(without(names, Cursor::new(packed)).unwrap()),
                TEXT,
                "{names}"
            );
        }
        for names in ["compress", "gzip, gzip, gzip, gzip"] {
            let other = without(names, Cursor::new(gzip.clone()))
                .err()
                .unwrap()
                .to_string();
            assert!(other.contains(&format!("compressed ({names})")), "{other}");
        }
        let broken = without("br", TEXT).unwrap().read_to_end(&mut Vec::new());
        assert!(broken.is_err());
    }
}
