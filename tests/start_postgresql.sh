#!/usr/bin/env bash
# Start a PostgreSQL for the tests on 127.0.0.1:5432, where none answers yet; on Debian it is installed first.
# Another one will do as well: THERMOTRUE_TEST_POSTGRESQL=postgresql://USER@HOST/DATABASE make test
set -euo pipefail
if [ -n "${THERMOTRUE_TEST_POSTGRESQL:-}" ] || (exec 3<>/dev/tcp/127.0.0.1/5432) 2>/dev/null; then
    exit 0
fi
if ! compgen -G "/usr/lib/postgresql/*/bin/initdb" >/dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq postgresql >/dev/null
fi
bin=$(dirname "$(compgen -G "/usr/lib/postgresql/*/bin/initdb" | tail -1)")
data=$(mktemp -d /tmp/thermotrue-postgresql-XXXXXX)
# It does not run as root; nobody but this computer reaches it, and it is thrown away.
as() { if [ "$(id -u)" = 0 ]; then su postgres -s /bin/sh -c "$1"; else sh -c "$1"; fi; }
[ "$(id -u)" != 0 ] || chown postgres "$data"
as "$bin/initdb --pgdata=$data --auth=trust --username=root --no-sync >/dev/null"
as "$bin/pg_ctl --pgdata=$data --wait --log=$data/log --options='-c listen_addresses=127.0.0.1 -k $data' start >/dev/null"
"$bin/createdb" --host=127.0.0.1 --username=root test
echo "PostgreSQL runs on 127.0.0.1:5432, its data in $data; stop it with pg_ctl --pgdata=$data stop"
