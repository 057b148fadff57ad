//! The address that a request comes from, through proxies that are trusted.
//!
//! Each proxy appends the address that it was asked from to `X-Forwarded-For`. A client may send the field as well, so only what
//! trusted proxies wrote can be believed: read from the right, the first address that is no trusted proxy is the client's.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};

use axum::http::HeaderMap;
use ipnet::IpNet;

const FORWARDED_FOR: &str = "x-forwarded-for";

/// Reads an address or a range of addresses, as in `10.0.0.0/8` or `::1`.
///
/// # Errors
/// Says what was expected.
pub fn parse_range(text: &str) -> Result<IpNet, String> {
    let text = text.trim();
    text.parse()
        .or_else(|_| text.parse::<IpAddr>().map(IpNet::from))
        .map_err(|_| format!("{text}: expected an IP address or a range such as 10.0.0.0/8"))
}

/// Returns whether an address lies in one of the ranges.
pub fn is_trusted(address: IpAddr, proxies: &[IpNet]) -> bool {
    let address = address.to_canonical();
    proxies.iter().any(|range| range.contains(&address))
}

/// Returns the client's address for a connection from `peer`.
pub fn of_client(peer: IpAddr, headers: &HeaderMap, proxies: &[IpNet]) -> IpAddr {
    let mut found = peer.to_canonical();
    let hops = headers.get_all(FORWARDED_FOR).iter().collect::<Vec<_>>();
    let mut hops = hops.into_iter().rev().flat_map(|value| value.as_bytes().rsplit(|b| *b == b','));
    while is_trusted(found, proxies) {
        let Some(hop) = hops.next() else { break };
        // Behind an entry that is no address, nothing can be believed.
        let Some(address) = std::str::from_utf8(hop).ok().and_then(parse_hop) else { break };
        found = address.to_canonical();
    }
    found
}

/// Reads an address that some proxies write with a port.
fn parse_hop(text: &str) -> Option<IpAddr> {
    let text = text.trim();
    let bare = text.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(text);
    bare.parse().ok().or_else(|| text.parse::<SocketAddr>().ok().map(|address| address.ip()))
}

/// Returns the address by which clients are told apart: that of the /64 network for IPv6, of which one client has all addresses.
pub fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) => {
            let [a, b, c, d, ..] = address.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn client(peer: &str, fields: &[&str]) -> String {
        let proxies =
            ["10.0.0.0/8", "fd00::/8", "192.0.2.7"].map(|text| parse_range(text).unwrap());
        let mut headers = HeaderMap::new();
        for field in fields {
            headers.append(FORWARDED_FOR, HeaderValue::from_str(field).unwrap());
        }
        of_client(peer.parse().unwrap(), &headers, &proxies).to_string()
    }

    #[test]
    fn forwarded_addresses_are_believed_from_trusted_proxies_only() {
        assert_eq!(client("198.51.100.9", &["1.2.3.4"]), "198.51.100.9");
        assert_eq!(client("10.1.1.1", &["1.2.3.4"]), "1.2.3.4");
        assert_eq!(client("::ffff:10.1.1.1", &["1.2.3.4"]), "1.2.3.4");
        assert_eq!(client("10.1.1.1", &[]), "10.1.1.1");
    }

    #[test]
    fn the_rightmost_untrusted_address_counts() {
        assert_eq!(client("10.1.1.1", &["6.6.6.6, 1.2.3.4, 192.0.2.7"]), "1.2.3.4");
        assert_eq!(client("10.1.1.1", &["6.6.6.6", "1.2.3.4", "10.2.2.2"]), "1.2.3.4");
        assert_eq!(client("10.1.1.1", &["10.3.3.3, 10.2.2.2"]), "10.3.3.3");
        // What stands left of a malformed entry is not believed.
        assert_eq!(client("10.1.1.1", &["1.2.3.4, unknown, 10.2.2.2"]), "10.2.2.2");
        assert_eq!(client("10.1.1.1", &["1.2.3.4:5678"]), "1.2.3.4");
        assert_eq!(client("fd00::1", &["[2001:db8::5]:443"]), "2001:db8::5");
        assert_eq!(client("fd00::1", &["[2001:db8::5]"]), "2001:db8::5");
    }

    #[test]
    fn ranges_and_networks() {
        assert!(parse_range("10.0.0.0/33").unwrap_err().contains("10.0.0.0/33"));
        assert!(parse_range("proxy").is_err());
        let shown = |text: &str| network(text.parse().unwrap()).to_string();
        assert_eq!(shown("2001:db8:1:2:3:4:5:6"), "2001:db8:1:2::");
        assert_eq!(shown("::ffff:1.2.3.4"), "1.2.3.4");
    }
}
