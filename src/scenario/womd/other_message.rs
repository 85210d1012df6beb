//! Records of other messages than `Scenario`, by their outline: a dataset that is published in
//! several forms, or another one in the same container.

/// Names of features that a message shows.
const MAX_SHOWN: usize = 3;
/// Features whose names are looked at.
const MAX_FEATURES: usize = 64;
/// Beginnings of the names of features in Waymo's `tf_example` form of the Motion Dataset.
const OF_MOTION: [&str; 4] = [
    "state/",
    "roadgraph_samples/",
    "traffic_light_state/",
    "scenario/",
];
/// Wire type of texts and messages inside others.
const LENGTH_DELIMITED: u64 = 2;

/// Tag of the time of a `Frame`, a number, which stands behind its context.
const TIME: u8 = 2 << 3;

/// What a payload is instead of a `Scenario` message, in words; `None` where that is not known.
pub(super) fn other_message(payload: &[u8]) -> Option<String> {
    if let Some(names) = feature_names(payload) {
        let shown = names.iter().take(MAX_SHOWN).cloned().collect::<Vec<_>>();
        let shown = shown.join(", ");
        let of_motion = names.iter().any(|name| {
            OF_MOTION
                .iter()
                .any(|beginning| name.starts_with(beginning))
        });
        return Some(if of_motion {
            format!(
                "a tf.Example record of Waymo's Motion Dataset (features {shown}), which is not read; take the file of the same \
                 number in the dataset's folder `scenario`"
            )
        } else {
            format!(
                "a tf.Example record of another dataset (features {shown}); Scenario messages of Waymo's Motion Dataset are read"
            )
        });
    }
    let segment = frame_segment(payload)?;
    Some(format!(
        "a camera and laser frame of Waymo's Perception Dataset (segment {segment}), which has no map of lanes; take the Motion \
         Dataset, folder `scenario`"
    ))
}

/// The names of the features of a `tf.Example`: field 1 holds entries with a name each.
fn feature_names(payload: &[u8]) -> Option<Vec<String>> {
    let (1, features, rest) = field(payload)? else {
        return None;
    };
    if !rest.is_empty() {
        return None;
    }
    let mut names = Vec::new();
    let mut entries = features;
    while !entries.is_empty() && names.len() < MAX_FEATURES {
        let (1, entry, behind) = field(entries)? else {
            return None;
        };
        let (1, name, _) = field(entry)? else {
            return None;
        };
        names.push(plain(name)?);
        entries = behind;
    }
    names.sort();
    (!names.is_empty()).then_some(names)
}

/// The name of the segment of a `Frame`: field 1 is its context, whose field 1 is the name.
fn frame_segment(payload: &[u8]) -> Option<String> {
    let (1, context, rest) = field(payload)? else {
        return None;
    };
    let (1, name, _) = field(context)? else {
        return None;
    };
    (rest.first() == Some(&TIME)).then(|| plain(name)).flatten()
}

/// A text that can be shown.
fn plain(bytes: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(bytes).ok()?;
    let fits = |c: char| c.is_ascii_graphic() || c == ' ';
    (!text.is_empty() && text.len() <= 100 && text.chars().all(fits)).then(|| text.to_owned())
}

/// The number and the bytes of the first field, if it has a length, and what follows.
fn field(bytes: &[u8]) -> Option<(u64, &[u8], &[u8])> {
    let (tag, rest) = varint(bytes)?;
    if tag & 7 != LENGTH_DELIMITED {
        return None;
    }
    let (length, rest) = varint(rest)?;
    let (own, behind) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    Some((tag >> 3, own, behind))
}

fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut value = 0_u64;
    for (i, byte) in bytes.iter().enumerate().take(9) {
        value |= u64::from(byte & 0x7f) << (7 * i);
        if byte & 0x80 == 0 {
            return Some((value, &bytes[i + 1..]));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn delimited(number: u8, bytes: &[u8]) -> Vec<u8> {
        let mut out = vec![number << 3 | 2];
        let mut length = bytes.len();
        while length > 127 {
            out.push(length as u8 | 0x80);
            length >>= 7;
        }
        out.push(length as u8);
        out.extend(bytes);
        out
    }

    fn example(names: &[&str]) -> Vec<u8> {
        let entries = names.iter().flat_map(|name| {
            // A list of 200 floats.
            let value = delimited(2, &delimited(2, &delimited(1, &[0; 800])));
            delimited(1, &[delimited(1, name.as_bytes()), value].concat())
        });
        delimited(1, &entries.collect::<Vec<_>>())
    }

    #[test]
    fn a_record_of_another_message_is_called_what_it_is() {
        let motion =
            other_message(&example(&["state/current/x", "roadgraph_samples/dir"])).unwrap();
        assert!(
            motion.contains("features roadgraph_samples/dir, state/current/x")
                && motion.contains("folder `scenario`"),
            "{motion}"
        );
        let pictures = other_message(&example(&["image/encoded", "image/format"])).unwrap();
        assert!(
            pictures.contains("another dataset (features image/encoded"),
            "{pictures}"
        );
        let context = delimited(1, &delimited(1, b"10017090168044687777_6380_000_6400_000"));
        let frame = other_message(&[context.clone(), vec![0x10, 5]].concat()).unwrap();
        assert!(
            frame.contains("Perception Dataset (segment 10017"),
            "{frame}"
        );
        assert_eq!(other_message(&context), None);
        assert_eq!(other_message(b""), None);
        // Packed times, as a Scenario has them.
        let times: Vec<u8> = (0..91)
            .flat_map(|i| (f64::from(i) / 10.0).to_le_bytes())
            .collect();
        assert_eq!(other_message(&delimited(1, &times)), None);
    }

    proptest! {
        #[test]
        fn any_bytes_are_looked_at_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = other_message(&bytes);
        }
    }
}
