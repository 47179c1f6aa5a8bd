"""Who vouches for a bundle: Ed25519 keys (RFC 8032) in PEM files, told by fingerprints."""

from __future__ import annotations

import base64
import binascii
import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from service.errors import RefusedInput

MAKE_KEYS = "`inertrim bundle keygen` makes a pair."


def make_keys(name: Path) -> tuple[Path, Path, str]:
    """Write a new pair, ``NAME.key`` (for its owner's eyes) and ``NAME.pub``, and return both with the fingerprint.

    Raises
    ------
    RefusedInput
        One of the files is there already.
    """
    private, public = name.with_name(name.name + ".key"), name.with_name(name.name + ".pub")
    for path in (private, public):
        if path.exists():
            raise RefusedInput(str(path), "is there already.", "Give another name: a key that is lost signs no more.")
    key = Ed25519PrivateKey.generate()
    with os.fdopen(os.open(private, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return private, public, fingerprint(key.public_key())


def fingerprint(key: Ed25519PublicKey) -> str:
    """Return the first 16 hexadecimal digits of the SHA-256 of the key's 32 bytes."""
    return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:16]


class Signer:
    """Signs with a private key's file.

    Raises
    ------
    RefusedInput
        The file holds no Ed25519 private key.
    """

    def __init__(self, path: Path) -> None:
        try:
            key = load_pem_private_key(path.read_bytes(), None)
        except (ValueError, TypeError, UnsupportedAlgorithm):
            key = None
        if not isinstance(key, Ed25519PrivateKey):
            raise RefusedInput(str(path), "holds no Ed25519 private key without a passphrase.", MAKE_KEYS)
        self._key = key

    def __call__(self, text: bytes) -> dict[str, str]:
        """Return fingerprint and signature."""
        signature = base64.b64encode(self._key.sign(text)).decode()
        return {"key": fingerprint(self._key.public_key()), "signature": signature}


class Trust:
    """The public keys whose owners are believed.

    Parameters
    ----------
    paths
        PEM files.

    Raises
    ------
    RefusedInput
        A file holds no Ed25519 public key.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._keys: dict[str, Ed25519PublicKey] = {}
        for path in paths:
            try:
                key = load_pem_public_key(path.read_bytes())
            except (ValueError, UnsupportedAlgorithm):
                key = None
            if not isinstance(key, Ed25519PublicKey):
                raise RefusedInput(str(path), "holds no Ed25519 public key.", f"Give the .pub file. {MAKE_KEYS}")
            self._keys[fingerprint(key)] = key

    def check(self, place: str, text: bytes, signature: Mapping[str, str]) -> None:
        """Refuse what no trusted key has signed."""
        key = self._keys.get(signature["key"])
        if key is None:
            trusted = ", ".join(sorted(self._keys))
            reason = f"is signed by key {signature['key']}, which is not trusted (trusted: {trusted})."
            raise RefusedInput(place, reason, "Get that key's .pub file from its owner and give it with --trust.")
        try:
            key.verify(base64.b64decode(signature["signature"], validate=True), text)
        except (InvalidSignature, binascii.Error):
            reason = f"was changed after key {signature['key']} signed it: the signature does not hold."
            raise RefusedInput(place, reason, "Do not use it; have it exported anew.") from None
