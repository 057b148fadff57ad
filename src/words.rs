//! Enums whose values are words: in requests, on the command line and in documents (floor 0).

/// Declares enums of words. A word is the name of its variant in snake case, unless the variant has another name. Users read the comments.
macro_rules! words {
    ($($(#[$($about:tt)*])* pub enum $name:ident $variants:tt)+) => {$(
        #[derive(
            Clone, Copy, Debug, Default, PartialEq, Eq, Hash,
            serde::Serialize, serde::Deserialize, utoipa::ToSchema, clap::ValueEnum,
        )]
        #[serde(rename_all = "snake_case")]
        #[value(rename_all = "snake_case")]
        $(#[$($about)*])*
        pub enum $name $variants
    )+};
}

pub(crate) use words;
