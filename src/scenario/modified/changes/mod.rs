//! The kinds of changes, a file each. A new one is its file and one line of the table below, which
//! is also the order in which changes apply.

mod cones;
mod crash;
mod crossing;
mod drivers;
mod goal;
mod jaywalker;
mod needs;
mod remove;
mod stopped;
mod traffic;
mod vehicle;

use super::change::{Change, Head, PlacedChange};
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::marker::PhantomData;
use toml::Spanned;

macro_rules! changes {
    ($($key:ident: $module:ident::$kind:ident,)*) => {
        /// The tables of a file by their keys.
        #[derive(Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub(super) struct Changes {
            #[serde(default)]
            name: Option<Spanned<String>>,
            #[serde(default)]
            kind: Option<Spanned<String>>,
            #[serde(default)]
            seed: u64,
            $(#[serde(default, deserialize_with = "tables")] $key: Vec<Spanned<$module::$kind>>,)*
        }

        impl Changes {
            /// The head and the changes of a text.
            pub(super) fn parse(text: &str) -> Result<(Head, Self), toml::de::Error> {
                let mut parsed: Self = toml::from_str(text)?;
                let head = Head { name: parsed.name.take(), kind: parsed.kind.take(), seed: parsed.seed };
                Ok((head, parsed))
            }

            /// The changes with their lines, in the order of the table.
            pub(super) fn placed(self, line_of: impl Fn(usize) -> usize) -> Vec<PlacedChange> {
                let mut all = Vec::new();
                $(for table in self.$key {
                    let line = line_of(table.span().start);
                    let change: Box<dyn Change> = Box::new(table.into_inner());
                    all.push(PlacedChange { key: stringify!($key), line, change });
                })*
                all
            }
        }
    };
}

/// The tables of one key, which TOML writes in double brackets.
fn tables<'de, D, T>(source: D) -> Result<Vec<Spanned<T>>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Tables<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Tables<T> {
        type Value = Vec<Spanned<T>>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a table in double brackets, as in [[goal]]")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut source: A) -> Result<Self::Value, A::Error> {
            let mut all = Vec::new();
            while let Some(table) = source.next_element()? {
                all.push(table);
            }
            Ok(all)
        }
    }
    source.deserialize_seq(Tables(PhantomData))
}

changes! {
    needs: needs::Needs,
    remove: remove::Remove,
    goal: goal::LaneGoal,
    stopped: stopped::Stopped,
    crash: crash::Crash,
    cones: cones::Cones,
    vehicle: vehicle::Vehicle,
    traffic: traffic::Traffic,
    jaywalker: jaywalker::CrossingPerson,
    crossing: crossing::CrossingVehicle,
    drivers: drivers::Drivers,
}
