//! Bytes as hexadecimal digits.

/// Two lower-case digits a byte.
///
/// # Example
/// ```
/// assert_eq!(types::hexadecimal::encode(&[0xa0, 0xff]), "a0ff");
/// ```
pub fn encode(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let digit = |nibble: u8| char::from(DIGITS[usize::from(nibble)]);
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

/// The bytes of two digits each, in either case; `None` for an odd number of digits and for other characters.
///
/// # Example
/// ```
/// use types::hexadecimal::decode;
///
/// assert_eq!(decode("A0ff"), Some(vec![0xa0, 0xff]));
/// assert_eq!([decode("a0f"), decode("+f")], [None, None]);
/// ```
pub fn decode(text: &str) -> Option<Vec<u8>> {
    let digit = |character: u8| char::from(character).to_digit(16);
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    let bytes = pairs.iter().map(|[high, low]| Some((digit(*high)? << 4 | digit(*low)?) as u8));
    rest.is_empty().then(|| bytes.collect())?
}
