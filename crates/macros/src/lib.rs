//! `#[derive(Documented)]`: hands the doc comments of a struct or enum to the program, so that `pwrfgs plugins` and
//! `docs/reference.md` say what the source says and nothing is kept twice.

use proc_macro::TokenStream;
use proc_macro2::TokenStream as Tokens;
use quote::{format_ident, quote};
use syn::{Attribute, Data, DeriveInput, Expr, ExprLit, Field, Fields, Lit, Meta, parse_macro_input};

/// Implements `pwrfgs_core::docs::Documented` and makes the type known by its `TypeId`. Fields whose type is documented too
/// are described in full; any other type is told by its name.
#[proc_macro_derive(Documented)]
pub fn documented(input: TokenStream) -> TokenStream {
    let input = parse_macro_input!(input as DeriveInput);
    described(&input).unwrap_or_else(|error| error.to_compile_error()).into()
}

fn described(input: &DeriveInput) -> syn::Result<Tokens> {
    if let Some(generic) = input.generics.params.first() {
        return Err(syn::Error::new_spanned(generic, "Documented describes types without parameters"));
    }
    let core = core_path();
    let whole = says(&input.attrs, "default");
    let body = match &input.data {
        Data::Struct(data) => {
            let fields = fields(&data.fields, whole, &core);
            quote!(#core::docs::Body::Fields(#fields))
        }
        Data::Enum(data) => {
            let variants = data.variants.iter().map(|variant| {
                let (name, text) = (variant.ident.to_string(), doc(&variant.attrs));
                let named = matches!(variant.fields, Fields::Named(_));
                let fields = fields(&variant.fields, false, &core);
                quote!(#core::docs::Variant { name: #name, text: #text, named: #named, fields: #fields })
            });
            quote!(#core::docs::Body::Variants(&[#(#variants),*]))
        }
        Data::Union(_) => return Err(syn::Error::new_spanned(&input.ident, "Documented describes no unions")),
    };
    let (name, text, ident) = (input.ident.to_string(), doc(&input.attrs), &input.ident);
    Ok(quote! {
        impl #core::docs::Documented for #ident {
            fn kind() -> #core::docs::Kind {
                static DOCS: #core::docs::Docs = #core::docs::Docs { name: #name, text: #text, body: #body };
                #core::docs::Kind::Of(&DOCS)
            }
        }
        #core::plugin::inventory::submit! {
            #core::docs::Entry { of: ::std::any::TypeId::of::<#ident>(), kind: <#ident as #core::docs::Documented>::kind }
        }
    })
}

/// `&[Field { .. }, ..]`.
fn fields(fields: &Fields, optional: bool, core: &Tokens) -> Tokens {
    let described = fields.iter().enumerate().filter(|(_, field)| !says(&field.attrs, "skip")).map(|(i, field)| {
        let Field { attrs, ident, ty, .. } = field;
        let name = ident.clone().unwrap_or_else(|| format_ident!("_{i}")).to_string();
        let text = doc(attrs);
        let optional = optional || says(attrs, "default");
        let words = quote!(#ty).to_string().replace(' ', "");
        quote!(#core::docs::Field {
            name: #name, text: #text, optional: #optional,
            kind: || {
                #[allow(unused_imports)]
                use #core::docs::Undocumented as _;
                #core::docs::Of::<#ty>::new(#words).kind()
            },
        })
    });
    quote!(&[#(#described),*])
}

/// The doc comment, line by line.
fn doc(attributes: &[Attribute]) -> String {
    let line = |attribute: &Attribute| match &attribute.meta {
        Meta::NameValue(pair) if pair.path.is_ident("doc") => match &pair.value {
            Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) => Some(text.value()),
            _ => None,
        },
        _ => None,
    };
    let lines = attributes.iter().filter_map(line);
    lines.map(|l| l.strip_prefix(' ').unwrap_or(&l).to_owned()).collect::<Vec<_>>().join("\n").trim().to_owned()
}

/// Whether `#[serde(..)]` has this word, alone or with a value.
fn says(attributes: &[Attribute], word: &str) -> bool {
    let mut found = false;
    for attribute in attributes.iter().filter(|a| a.path().is_ident("serde")) {
        // What serde makes of the rest is serde's to judge.
        _ = attribute.parse_nested_meta(|meta| {
            found |= meta.path.is_ident(word);
            if meta.input.peek(syn::Token![=]) {
                meta.value()?.parse::<Expr>()?;
            }
            Ok(())
        });
    }
    found
}

/// Where the types are: in `pwrfgs-core` for a crate that names it, else behind the facade.
fn core_path() -> Tokens {
    let manifest = std::env::var("CARGO_MANIFEST_PATH").ok().and_then(|path| std::fs::read_to_string(path).ok());
    if manifest.is_some_and(|text| text.contains("pwrfgs-core")) {
        quote!(::pwrfgs_core)
    } else {
        quote!(::pwrfgs::core)
    }
}
