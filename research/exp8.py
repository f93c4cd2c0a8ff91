import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from exp1 import _curvature,_trust
from twinct.recon.ray_weights import error_of_model
def formula(A,p,nv,m2,kappa=3.5):
    g=A.geometry; mag=np.linalg.norm(g.source,axis=1).mean()/np.linalg.norm(g.detector-g.source,axis=1).mean()
    q=g.panel.pitch_u*mag; w=1/(nv+np.float32(m2)); seen=p>0.02*np.percentile(p,99)
    return np.sqrt(len(A)*float(np.mean((w*w*(nv+kappa*m2))[seen])))/q, w
def trial(A,p,nv,m2,exps,its=5,tv=8):
    n=len(A); k=max(1,n//10); k=10 if n<100 else 20
    b0,w=formula(A,p,nv,m2)
    ov=sorted(subsets_of(A.geometry,k)[0]); used=sorted(set(range(n))-set(ov))
    B,q,ww=A[used],p[used],w[used]
    x=sart(B,q,iterations=3,relaxation=1.0,nonnegative=True).array.copy()
    V=float(np.prod(A.grid.voxel)); _,mean=_curvature([(B[v],v) for v in subsets_of(B.geometry,10)],_trust(B,ww,None))
    O=A[ov]; mw=float(np.mean(w[ov])*m2); cv=[]
    for e in exps:
        x=minimised(B,q,x,Variation(B,b0*2.0**e*V/mean,tv,np.float32(0)),iterations=its,rounds=1,subsets=min(10,len(B)),weights=ww,huber=None,mask=None,callback=None).array.copy()
        cv.append(float(np.mean(np.square(O(x)-p[ov])*w[ov])))
    return np.array(cv),mw
def pick(exps,cv,mw,c):
    t=cv.min()+c*mw; k=int(np.argmax(cv<=t))
    if k==0: return exps[0]
    f=(cv[k-1]-t)/(cv[k-1]-cv[k]); return exps[k-1]+f*(exps[k]-exps[k-1])
if __name__=="__main__":
  EX=np.array([4,3,2,1,0,-1,-2,-3.])
  tot={}
  for l in open(sys.argv[1]):
    r=json.loads(l); s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    b1,_=formula(A,p,noise_var(p,s.photons),r["m2"]); ef=np.log2(b1*s.mu/10)
    e=np.array([x["e"] for x in r["rows"]],float); le=np.log(np.array([x["err"] for x in r["rows"]])); 
    Ac=A.on(A.grid.with_voxels(2*A.grid.voxel,0*A.grid.voxel),A.geometry.binned(2,2)); pc,_=binned(p,None,(2,2)); 
    nvc=noise_var(pc,None if s.photons is None else 4*s.photons)
    xc=sart(Ac,pc,iterations=4,relaxation=1.0,nonnegative=True).array
    m2c=error_of_model(Ac,xc)
    cv,mw=trial(Ac,pc,nvc,m2c,EX)
    out=[]
    for c in (.2,.3,.4,.5,.7):
        rho=pick(EX,cv,mw,c); x=ef+rho
        loss=np.exp(np.interp(np.clip(x,e[-1],e[0]),e[::-1],le[::-1])-le.min()); out.append((rho,loss)); tot.setdefault(c,[]).append(loss)
    print(r["seed"],s.family,"m2c/(4 m2) %.2f"%(m2c/4/r["m2"]),"best-formula %.1f"%(e[le.argmin()]-ef)," ".join("rho %.1f loss %.2f"%o for o in out),"cv-min/mw",((cv-cv.min())/mw).round(2),flush=True)
  for c,v in tot.items(): print(c,"median %.3f p90 %.3f max %.2f"%(np.median(v),np.percentile(v,90),max(v)))
