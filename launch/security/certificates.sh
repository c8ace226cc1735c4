#!/bin/sh
# Makes a certificate authority, and one certificate for each name, for mutual TLS (docs/security.md):
#
#   sh launch/security/certificates.sh FOLDER robot operator reader
#
# The name is the common name of the certificate, by which access control tells programs apart. Every FOLDER/NAME.key is a
# secret of whoever runs as NAME; FOLDER/ca.key is yours: who has it can make certificates. FOLDER/ca.pem goes to everybody.
# What exists is kept, so that names can be added later.
set -eu
umask 077
folder=$1
shift
mkdir -p "$folder"
cd "$folder"

days=825
if [ ! -e ca.pem ]; then
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -noenc -days "$days" \
        -subj "/CN=dermis certificate authority" -addext "basicConstraints=critical,CA:TRUE" \
        -addext "keyUsage=critical,keyCertSign,cRLSign" -keyout ca.key -out ca.pem 2>/dev/null
fi
for name in "$@"; do
    [ ! -e "$name.pem" ] || continue
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -noenc -subj "/CN=$name" \
        -keyout "$name.key" -out "$name.csr" 2>/dev/null
    printf 'basicConstraints=CA:FALSE\nkeyUsage=digitalSignature\nextendedKeyUsage=serverAuth,clientAuth\nsubjectAltName=DNS:%s\n' \
        "$name" >"$name.ext"
    openssl x509 -req -in "$name.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days "$days" \
        -extfile "$name.ext" -out "$name.pem" 2>/dev/null
    rm "$name.csr" "$name.ext"
done
