//! Pictures of a run: what is no PNG of a usual size is none.

use super::limits::MAX_IMAGE_PIXELS;
use image::{ImageFormat, ImageReader};
use std::io::Cursor;

/// Whether bytes are a PNG that a page can show.
pub(super) fn is_picture(bytes: &[u8]) -> bool {
    let reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
    reader
        .into_dimensions()
        .is_ok_and(|(width, height)| width.max(height) <= MAX_IMAGE_PIXELS && width.min(height) > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    fn png(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        RgbImage::new(width, height)
            .write_to(&mut bytes, ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    }

    #[test]
    fn other_bytes_are_no_picture() {
        assert!(is_picture(&png(4, 3)));
        assert!(!is_picture(&png(MAX_IMAGE_PIXELS + 1, 1)));
        for bytes in [&b""[..], b"-----BEGIN KEY-----", &png(4, 3)[..20]] {
            assert!(!is_picture(bytes));
        }
    }
}
