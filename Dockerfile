# docker build -t splitknit .
# docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" splitknit             # the demonstration, into ./demo
# docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" splitknit reconstruct my_capture --out my_result
# docker run --rm -v "$PWD:/data" --user "$(id -u):$(id -g)" -p 8321:8321 splitknit serve --gallery g.skg --token-file token --host 0.0.0.0 --certificate c.pem --certificate-key k.pem
# The image below is named by a tag, which may be given to another one; pin it by its digest where that matters:
#   docker buildx imagetools inspect python:3.13-slim --format '{{.Manifest.Digest}}'
#   docker build --build-arg PYTHON=python:3.13-slim@sha256:... -t splitknit .
ARG PYTHON=python:3.13-slim

# Versions and hashes are those of constraints.txt, as in the Makefile; only a newer pip takes hashes from there
FROM ${PYTHON} AS build
COPY constraints.txt /tmp/
RUN sed -n '/^pip==/,/[^\\]$/p' /tmp/constraints.txt > /tmp/pip.txt \
    && pip install --no-cache-dir --require-hashes -r /tmp/pip.txt
COPY packages /source
RUN PIP_BUILD_CONSTRAINT=/tmp/constraints.txt pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /source/*

FROM ${PYTHON}
COPY constraints.txt /tmp/
COPY --from=build /wheels /wheels
COPY --from=build /tmp/pip.txt /tmp/
RUN pip install --no-cache-dir --require-hashes -r /tmp/pip.txt \
    && pip install --no-cache-dir --no-deps /wheels/*.whl \
    && pip install --no-cache-dir --require-hashes --constraint /tmp/constraints.txt splitknit \
        splitknit-simulator splitknit-rig 'splitknit-match[plot,serve]' \
    && rm -r /wheels /tmp/constraints.txt /tmp/pip.txt \
    && useradd --uid 10001 splitknit \
    && install --directory --owner splitknit /data
USER 10001
WORKDIR /data
ENV HOME=/tmp
ENTRYPOINT ["splitknit"]
CMD ["demo", "--out", "demo"]
