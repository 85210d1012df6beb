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
    let named = response
        .headers()
        .get(CONTENT_ENCODING)
        .and_then(|name| name.to_str().ok())
        .unwrap_or_default();
    let name = named.trim().to_ascii_lowercase();
    match name.as_str() {
        "" | "identity" => Ok(Box::new(response)),
        "gzip" | "x-gzip" => Ok(Box::new(MultiGzDecoder::new(response))),
        "deflate" => Ok(Box::new(ZlibDecoder::new(response))),
        _ => Err(EndpointFailure::InvalidReply(format!(
            "the reply is compressed ({name}), which the request did not ask for; switch compression off in the server \
             or in the proxy before it"
        ))),
    }
}
