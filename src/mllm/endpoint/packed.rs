//! Compressed responses. No request asks for one, and some proxies compress all the same.

use crate::EndpointFailure;
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use reqwest::blocking::Response;
use reqwest::header::CONTENT_ENCODING;
use std::io::Read;

/// The bytes of a response without its compression. Their reader limits how many there are.
///
/// # Errors
/// When the compression is another one; the text names it.
pub(super) fn unpacked(response: Response) -> Result<Box<dyn Read + Send>, EndpointFailure> {
    let named = response.headers().get(CONTENT_ENCODING);
    let name = named.map_or(Ok(""), |name| name.to_str()).unwrap_or("?");
    let name = name.trim().to_ascii_lowercase();
    without(&name, response)
}

/// Bytes without a compression by its name in HTTP.
fn without(
    name: &str,
    bytes: impl Read + Send + 'static,
) -> Result<Box<dyn Read + Send>, EndpointFailure> {
    match name {
        "" | "identity" => Ok(Box::new(bytes)),
        "gzip" | "x-gzip" => Ok(Box::new(MultiGzDecoder::new(bytes))),
        "deflate" => Ok(Box::new(ZlibDecoder::new(bytes))),
        _ => Err(EndpointFailure::InvalidReply(format!(
            "the reply is compressed ({name}), which the request did not ask for; switch compression off in the server \
             or in the proxy before it"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::Compression;
    use flate2::read::{GzEncoder, ZlibEncoder};

    #[test]
    fn a_compressed_reply_is_read_or_its_compression_is_named() {
        let text: &[u8] = b"{\"choices\": []}";
        let read = |name: &str, mut packed: Box<dyn Read + Send>| {
            let mut bytes = Vec::new();
            packed.read_to_end(&mut bytes).unwrap();
            let mut plain = Vec::new();
            without(name, std::io::Cursor::new(bytes))
                .unwrap()
                .read_to_end(&mut plain)
                .unwrap();
            plain
        };
        let packed = Compression::fast();
        assert_eq!(read("", Box::new(text)), text);
        assert_eq!(read("gzip", Box::new(GzEncoder::new(text, packed))), text);
        assert_eq!(
            read("deflate", Box::new(ZlibEncoder::new(text, packed))),
            text
        );
        let other = without("br", text).err().unwrap().to_string();
        assert!(other.contains("compressed (br)"), "{other}");
    }
}
