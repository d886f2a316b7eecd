//! `#[derive(Message)]`: what a message says of itself, from its fields.
//!
//! Everything is written for every field, so that a field added later cannot be forgotten: it is in the digest, and in
//! snapshots, or somebody has said why not. The documentation is with the trait, `foveal_runtime::Message`.

mod attributes;

use proc_macro2::TokenStream;
use quote::{format_ident, quote};
use syn::{Data, DeriveInput, Fields, Ident, Type, parse_macro_input};

use attributes::{OfField, OfVariant};

/// Makes `kind`, `digest`, `content`, `lane`, `size_bytes`, `save` and `restore` of a message: see `foveal_runtime::Message`.
#[proc_macro_derive(Message, attributes(message))]
pub fn message(input: proc_macro::TokenStream) -> proc_macro::TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    expand(&input).unwrap_or_else(|error| error.to_compile_error()).into()
}

/// One variant of an enum, or all of a struct.
struct Variant {
    path: TokenStream,
    name: String,
    index: u8,
    fields: Vec<Field>,
    of: OfVariant,
}

struct Field {
    /// Its name, or its number.
    member: syn::Member,
    /// What it is called here.
    binding: Ident,
    ty: Type,
    of: OfField,
}

impl Variant {
    fn new(
        path: TokenStream,
        name: &Ident,
        index: usize,
        attributes: &[syn::Attribute],
        fields: &Fields,
    ) -> syn::Result<Self> {
        let of = OfVariant::parse(attributes)?;
        let index =
            u8::try_from(index).map_err(|_| syn::Error::new_spanned(name, "more than 256 variants"))?;
        let fields = fields.members().zip(fields).map(|(member, field)| {
            let binding = match &member {
                syn::Member::Named(name) => name.clone(),
                syn::Member::Unnamed(number) => format_ident!("_{}", number.index),
            };
            Ok(Field { member, binding, ty: field.ty.clone(), of: OfField::parse(&field.attrs)? })
        });
        Ok(Self { path, name: name.to_string(), index, fields: fields.collect::<syn::Result<_>>()?, of })
    }

    /// An arm of a match over all fields; what is not used there is no mistake.
    fn arm(&self, body: &TokenStream) -> TokenStream {
        let path = &self.path;
        let bindings = self.fields.iter().map(|Field { member, binding, .. }| match member {
            syn::Member::Named(_) => quote! { #binding },
            syn::Member::Unnamed(_) => quote! { #member: #binding },
        });
        quote! { #[allow(unused_variables)] #path { #(#bindings),* } => { #body } }
    }

    fn digest(&self) -> TokenStream {
        let index = u32::from(self.index);
        let hashed = || self.fields.iter().filter(|field| !field.of.skip);
        let with = hashed().filter_map(|Field { binding, of, .. }| {
            of.with.as_ref().map(|with| quote! { #with::digest(#binding, __digest); })
        });
        let plain: Vec<&Ident> =
            hashed().filter(|field| field.of.with.is_none()).map(|field| &field.binding).collect();
        // Tuples, since each value costs a beginning and an end; serde knows those of 16.
        let plain = plain.chunks(16).map(|fields| quote! { __digest.value(&(#(#fields,)*)); });
        self.arm(&quote! { __digest.u32(#index); #(#plain)* #(#with)* })
    }

    /// Named values; what is neither serialized nor saved by a module of its own is not told.
    fn content(&self, whole: &OfVariant) -> TokenStream {
        let unsaved = self.of.unsaved || whole.unsaved;
        let fields = self.fields.iter().map(|Field { member, binding, of, .. }| {
            let name = quote! { #member }.to_string();
            let content = match &of.with {
                Some(with) => quote! { #with::content(#binding) },
                None if of.skip && unsaved => quote! { ::foveal_runtime::Content::Untold },
                None => quote! { ::foveal_runtime::Content::of(#binding) },
            };
            quote! { (#name, #content) }
        });
        let count = self.fields.len();
        self.arm(&quote! {
            let fields: [(&'static str, ::foveal_runtime::Content); #count] = [#(#fields),*];
            ::foveal_runtime::Content::variant(::foveal_runtime::Message::kind(self), fields)
        })
    }

    fn kind(&self) -> TokenStream {
        let name = &self.name;
        self.arm(&self.of.kind.as_ref().map_or_else(|| quote! { #name }, |kind| quote! { #kind }))
    }

    fn lane(&self) -> TokenStream {
        let lane = self.of.lane.as_ref().map_or_else(|| quote! { Data }, |lane| quote! { #lane });
        self.arm(&quote! { ::foveal_runtime::Lane::#lane })
    }

    fn size(&self) -> TokenStream {
        self.arm(&self.of.size.as_ref().map_or_else(|| quote! { 0 }, |size| quote! { #size }))
    }

    fn save(&self) -> TokenStream {
        if self.of.unsaved {
            return self.arm(&quote! { __saver.refuse(); });
        }
        let (index, fields) = (self.index, self.fields.iter().map(Field::save));
        self.arm(&quote! { __saver.put(&#index); #(#fields)* })
    }

    fn restore(&self) -> TokenStream {
        let (path, index) = (&self.path, self.index);
        if self.of.unsaved {
            return quote! { #index => return ::core::option::Option::None, };
        }
        let fields = self.fields.iter().map(Field::restore);
        quote! { #index => #path { #(#fields),* }, }
    }
}

impl Field {
    fn save(&self) -> TokenStream {
        let binding = &self.binding;
        match &self.of.with {
            Some(with) => quote! { #with::save(#binding, __saver); },
            None => quote! { __saver.put(#binding); },
        }
    }

    fn restore(&self) -> TokenStream {
        let Self { member, ty, .. } = self;
        match &self.of.with {
            Some(with) => quote! { #member: #with::restore(__loader)? },
            None => quote! { #member: __loader.take::<#ty>()? },
        }
    }
}

fn expand(input: &DeriveInput) -> syn::Result<TokenStream> {
    let name = &input.ident;
    let whole = OfVariant::parse(&input.attrs)?;
    let variants: Vec<Variant> = match &input.data {
        Data::Struct(data) => vec![Variant::new(quote! { Self }, name, 0, &input.attrs, &data.fields)?],
        Data::Enum(data) => {
            if let Some(misplaced) = whole.misplaced() {
                return Err(syn::Error::new_spanned(name, format!("`{misplaced}` belongs to a variant")));
            }
            let variants = data.variants.iter().enumerate();
            let made = variants.map(|(index, variant)| {
                let name = &variant.ident;
                Variant::new(quote! { Self::#name }, name, index, &variant.attrs, &variant.fields)
            });
            made.collect::<syn::Result<_>>()?
        }
        Data::Union(_) => return Err(syn::Error::new_spanned(name, "a message is an enum or a struct")),
    };

    let lanes = variants.iter().any(|variant| variant.of.lane.is_some()).then(|| {
        let body = each(&variants, Variant::lane);
        quote! { fn lane(&self) -> ::foveal_runtime::Lane { #body } }
    });
    let sizes = variants.iter().any(|variant| variant.of.size.is_some()).then(|| {
        let body = each(&variants, Variant::size);
        quote! { fn size_bytes(&self) -> usize { #body } }
    });
    let saved = (!whole.unsaved).then(|| {
        let (save, restores) = (each(&variants, Variant::save), variants.iter().map(Variant::restore));
        quote! {
            fn save(&self, __saver: &mut ::foveal_runtime::Saver) {
                #save
            }

            #[allow(unreachable_code)]
            fn restore(__loader: &mut ::foveal_runtime::Loader<'_>) -> ::core::option::Option<Self> {
                ::core::option::Option::Some(match __loader.take::<u8>()? {
                    #(#restores)*
                    _ => return ::core::option::Option::None,
                })
            }
        }
    });
    let (digest, kind) = (each(&variants, Variant::digest), each(&variants, Variant::kind));
    let content = each(&variants, |variant| variant.content(&whole));
    let (generics, of, conditions) = input.generics.split_for_impl();
    Ok(quote! {
        #[automatically_derived]
        impl #generics ::foveal_runtime::Message for #name #of #conditions {
            fn digest(&self, __digest: &mut ::foveal_runtime::Digest) {
                #digest
            }

            fn kind(&self) -> &'static str {
                #kind
            }

            fn content(&self) -> ::foveal_runtime::Content {
                #content
            }

            #lanes
            #sizes
            #saved
        }
    })
}

/// A match over all variants. One without any has no values, so neither has its match.
fn each(variants: &[Variant], arm: impl Fn(&Variant) -> TokenStream) -> TokenStream {
    let arms = variants.iter().map(arm);
    if variants.is_empty() {
        quote! { match *self {} }
    } else {
        quote! { match self { #(#arms)* } }
    }
}
