//! What can be said in `#[message(…)]`.

use proc_macro2::TokenStream;
use quote::quote;
use syn::meta::ParseNestedMeta;
use syn::{Attribute, Expr, Ident, LitInt, LitStr, Path, parenthesized};

/// Of a variant, or of a whole message.
#[derive(Default)]
pub struct OfVariant {
    /// The name in reports, where it is not the variant's.
    pub kind: Option<Expr>,
    /// The variant of `Lane`.
    pub lane: Option<TokenStream>,
    /// Bytes beyond the value itself.
    pub size: Option<Expr>,
    /// There are no snapshots while it waits.
    pub unsaved: bool,
}

/// Of a field.
#[derive(Default)]
pub struct OfField {
    /// Not in the digest.
    pub skip: bool,
    /// A module with functions for it.
    pub with: Option<Path>,
}

impl OfVariant {
    pub fn parse(attributes: &[Attribute]) -> syn::Result<Self> {
        let mut found = Self::default();
        each(attributes, |meta| {
            if meta.path.is_ident("kind") {
                found.kind = Some(meta.value()?.parse()?);
            } else if meta.path.is_ident("lane") {
                found.lane = Some(lane(meta)?);
            } else if meta.path.is_ident("size") {
                found.size = Some(meta.value()?.parse()?);
            } else if meta.path.is_ident("unsaved") {
                reason(meta)?;
                found.unsaved = true;
            } else {
                return Err(meta.error("a variant has `kind`, `lane`, `size` or `unsaved`"));
            }
            Ok(())
        })?;
        Ok(found)
    }

    /// What cannot be said of an enum as a whole.
    pub fn misplaced(&self) -> Option<&'static str> {
        let all =
            [("kind", self.kind.is_some()), ("lane", self.lane.is_some()), ("size", self.size.is_some())];
        all.into_iter().find_map(|(name, there)| there.then_some(name))
    }
}

impl OfField {
    pub fn parse(attributes: &[Attribute]) -> syn::Result<Self> {
        let mut found = Self::default();
        each(attributes, |meta| {
            if meta.path.is_ident("skip") {
                reason(meta)?;
                found.skip = true;
            } else if meta.path.is_ident("with") {
                found.with = Some(meta.value()?.parse()?);
            } else {
                return Err(meta.error("a field has `skip` or `with`"));
            }
            Ok(())
        })?;
        Ok(found)
    }
}

fn each(
    attributes: &[Attribute],
    mut one: impl FnMut(&ParseNestedMeta<'_>) -> syn::Result<()>,
) -> syn::Result<()> {
    let ours = attributes.iter().filter(|attribute| attribute.path().is_ident("message"));
    ours.into_iter().try_for_each(|attribute| attribute.parse_nested_meta(|meta| one(&meta)))
}

/// Leaving something out takes a reason.
fn reason(meta: &ParseNestedMeta<'_>) -> syn::Result<()> {
    let why: LitStr =
        meta.value().and_then(|value| value.parse()).map_err(|_| meta.error("say why: `= \"…\"`"))?;
    if why.value().trim().is_empty() { Err(meta.error("say why")) } else { Ok(()) }
}

fn lane(meta: &ParseNestedMeta<'_>) -> syn::Result<TokenStream> {
    let value = meta.value()?;
    let name: Ident = value.parse()?;
    match name.to_string().as_str() {
        "data" => Ok(quote! { Data }),
        "control" => Ok(quote! { Control }),
        "latest" => {
            let content;
            parenthesized!(content in value);
            let key: LitInt = content.parse()?;
            match key.base10_parse::<u8>()? {
                0..8 => Ok(quote! { Latest(#key) }),
                _ => Err(syn::Error::new_spanned(key, "newest-only slots are 0 to 7")),
            }
        }
        _ => Err(syn::Error::new_spanned(name, "a lane is `data`, `control` or `latest(KEY)`")),
    }
}
